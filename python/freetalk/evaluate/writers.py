"""A report as a table for the terminal, CSV, JSON or LaTeX."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from freetalk._files import write_text

Report = dict[str, Any]
_ARROWS = {"down": "↓", "up": "↑", "near": "→"}
_SIGNIFICANT = 0.05
_COLUMNS = (
    *("system", "metric", "mean", "low", "high", "unit", "mask", "mask_count", "mask_sha256"),
    *("mean_over", "sequences", "frames", "ideal", "p_permutation", "p_wilcoxon", "p_holm"),
    *("against", "ground_truth", "source"),
)


def number(value: float | None, digits: int = 4) -> str:
    """A number with so many significant digits, without an exponent where that stays short."""
    if value is None:
        return "–"
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    return f"{value:.{max(decimals, 0)}f}" if -4 < decimals <= 8 else f"{value:.{digits}g}"


def plain_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of text in columns, the first left, the others right; a line under the first row."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for index, row in enumerate(rows):
        cells = [
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths))
        ]
        lines.append("  ".join(cells).rstrip())
        if index == 0:
            lines.append("-" * (sum(widths) + 2 * (len(widths) - 1)))
    return "\n".join(lines)


def terminal(report: Report) -> str:
    """Metrics down, systems across, intervals and p-values; masks, units and notes below."""
    names = [system["name"] for system in report["systems"]]
    has_truth = any(row["ground_truth"] for row in report["metrics"])
    others = [name for name in names if name != report["baseline"]] if report["baseline"] else []
    header = ["metric", "unit", "mask"]
    for name in names:
        header += [name, "interval", *(["p"] if name in others else [])]
    rows = [header + (["ground truth"] if has_truth else [])]
    for row in report["metrics"]:
        mask = (
            row["mask"] if row["mask"] in report["masks"] or row["mask"] == "all" else "lip pairs"
        )
        cells = [f"{row['title']} {_ARROWS[row['better']]}", row["unit"], mask]
        for name in names:
            score = row["systems"].get(name)
            cells += _cells(score)
            if name in others:
                test = row["paired"].get(name)
                cells.append("" if test is None else _p_value(test["p_holm"]))
        if has_truth:
            own = row["ground_truth"]
            cells.append("" if own is None else number(own["mean"]))
        rows.append(cells)
    return plain_table(rows) + "\n\n" + "\n".join(_footer(report))


def comma_separated(report: Report) -> str:
    """One line a system and metric, with everything needed to know what the number is."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    truth = report["ground_truth"].get("source") or report["ground_truth"].get("name", "")
    for row in report["metrics"]:
        mask = report["masks"].get(row["mask"], {})
        for name, score in row["systems"].items():
            test = row["paired"].get(name, {})
            writer.writerow(
                [
                    name,
                    row["metric"],
                    score["mean"],
                    _blank(score["low"]),
                    _blank(score["high"]),
                    row["unit"],
                    row["mask"],
                    mask.get("count", ""),
                    mask.get("sha256", ""),
                    row["mean_over"],
                    score["sequences"],
                    report["frames"],
                    _blank(row["ideal"]),
                    test.get("p_permutation", ""),
                    test.get("p_wilcoxon", ""),
                    test.get("p_holm", ""),
                    test.get("against", ""),
                    truth,
                    row["source"],
                ]
            )
    return text.getvalue()


def latex(report: Report) -> str:
    """Systems down, metrics across (booktabs); the best of each is bold, the caption names the masks.

    A dagger marks a difference from the baseline with a Holm-corrected p below 0.05.
    """
    rows = report["metrics"]
    arrows = {"down": r"$\downarrow$", "up": r"$\uparrow$", "near": r"$\rightarrow$"}
    titles = [f"{_tex_title(row['title'])} {arrows[row['better']]}" for row in rows]
    units = ["" if row["unit"] == "1" else _tex_unit(row["unit"]) for row in rows]
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\begin{{tabular}}{{l{'r' * len(rows)}}}",
        r"\toprule",
        " & ".join(["", *titles]) + r" \\",
        " & ".join(["", *units]) + r" \\",
        r"\midrule",
    ]
    best = [_best(row) for row in rows]
    for system in report["systems"]:
        name = system["name"]
        cells = [_tex(name)]
        for row, least in zip(rows, best):
            score = row["systems"].get(name)
            shown = "--" if score is None else number(score["mean"], 3)
            if score is not None and len(row["systems"]) > 1 and name in least:
                shown = rf"\textbf{{{shown}}}"
            test = row["paired"].get(name)
            cells.append(shown + (r"$^\dagger$" if test and test["p_holm"] < _SIGNIFICANT else ""))
        lines.append(" & ".join(cells) + r" \\")
    caption = " ".join(_tex(line) for line in _footer(report))
    if report["baseline"]:
        caption += rf" $\dagger$: differs from {_tex(report['baseline'])}, Holm-corrected p < 0.05."
    lines += [r"\bottomrule", r"\end{tabular}", rf"\caption{{{caption}}}", r"\end{table}"]
    return "\n".join(lines) + "\n"


def json_text(report: Report) -> str:
    """All of it."""
    return json.dumps(report, indent=2, ensure_ascii=False) + "\n"


#: Writers by the ending of a file's name.
FORMATS: dict[str, Callable[[Report], str]] = {
    ".json": json_text,
    ".csv": comma_separated,
    ".tex": latex,
    ".txt": terminal,
}


def write_report(report: Report, path: Path) -> None:
    """Writes a report in the format of the file's name; readers see the old file or the new one.

    Raises:
        ValueError: no such format.
    """
    if path.suffix.lower() not in FORMATS:
        raise ValueError(f"'{path}' does not say what to write: end it in {', '.join(FORMATS)}")
    write_text(path, FORMATS[path.suffix.lower()](report))


def _cells(score: dict[str, Any] | None) -> list[str]:
    if score is None:
        return ["–", ""]
    if score["low"] is None:
        return [number(score["mean"]), ""]
    return [number(score["mean"]), f"[{number(score['low'])}, {number(score['high'])}]"]


def _p_value(value: float) -> str:
    return "<0.001" if value < 0.001 else f"{value:.3f}"


def _blank(value: float | None) -> float | str:
    return "" if value is None else value


def _best(row: dict[str, Any]) -> set[str]:
    """The systems nearest to the ideal."""
    if row["ideal"] is None:
        return set()
    away = {name: abs(score["mean"] - row["ideal"]) for name, score in row["systems"].items()}
    least = min(away.values(), default=0.0)
    return {name for name, distance in away.items() if distance == least}


def _footer(report: Report) -> list[str]:
    """What the numbers are of."""
    truth, statistics = report["ground_truth"], report["statistics"]
    unit = truth.get("metres_per_unit")
    where = truth.get("source") or truth.get("name")
    lines = [
        f"Ground truth: {where}, {truth['sequences_scored']} sequences, {report['frames']} frames, "
        f"{truth['vertices']} vertices, "
        + ("no frame rate" if truth["fps"] is None else f"{truth['fps']:g} fps")
        + (f", {unit:g} m per unit." if unit is not None else ", metres.")
    ]
    for name, mask in report["masks"].items():
        known = f" ({mask['known_as']})" if mask["known_as"] else ""
        lines.append(
            f"Mask {name}: {mask['count']} of {mask['vertices']} vertices, sha256 {mask['sha256']}, "
            f"{Path(mask['source']).name}{known}."
        )
    percent = 100 * statistics["confidence"]
    lines.append(
        f"Intervals: {percent:g} %, {statistics['intervals']} ({statistics['count']}), "
        f"{statistics['resamples']} resamples."
    )
    if report["baseline"]:
        lines.append(
            f"p: paired permutation test over {statistics['drawn']} against {report['baseline']}, Holm-corrected over all metrics."
        )
    lines += [f"Note: {note}." for note in report["notes"]]
    return lines


def _tex(text: str) -> str:
    for symbol in "\\&%$#_{}":
        text = text.replace(symbol, f"\\{symbol}" if symbol != "\\" else r"\textbackslash ")
    return text.replace("^", r"\^{}").replace("–", "--").replace("…", r"\dots ")


def _tex_title(title: str) -> str:
    text = _tex(title).replace("|", "$|$")
    return text.replace(r"delta\_M", r"$\delta_M$").replace(r"delta\_Cd", r"$\delta_{Cd}$")


def _tex_unit(unit: str) -> str:
    return "$" + re.sub(r"[a-z]+", lambda found: rf"\mathrm{{{found[0]}}}", unit) + "$"
