"""A table's results as Markdown, JSON and a plot."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from freetalk import metrics
from freetalk._files import write_json, write_text
from freetalk.evaluate.clusters import cluster_means, clusters_of
from freetalk.evaluate.writers import number
from freetalk.tables.claims import MIN_SEEDS, judge, origins_of
from freetalk.tables.plot import draw, is_still
from freetalk.tables.scoring import DIVERSITY, pooling_of, title_of, unit_of
from freetalk.tables.sets import Catalogue
from freetalk.tables.sizes import Size
from freetalk.tables.table import RowResult, Table
from freetalk.train.checkpoint import git_commit

FORMAT = "freetalk-table"
ALL = "all"
_DIGITS = 5


def write_results(
    table: Table,
    rows: Sequence[RowResult],
    size: Size,
    catalogue: Catalogue,
    out: Path,
    command: str,
    seed: int,
) -> list[Path]:
    """Writes ``NAME.json``, ``NAME.md`` and ``NAME.png`` and returns their paths."""
    result = make_result(table, rows, size, catalogue, command, seed)
    paths = [out / f"{table.name}.{ending}" for ending in ("json", "md", "png")]
    write_json(paths[0], result)
    write_text(paths[1], markdown(result))
    draw(result, paths[2])
    return paths


def make_result(
    table: Table,
    rows: Sequence[RowResult],
    size: Size,
    catalogue: Catalogue,
    command: str,
    seed: int,
) -> dict[str, Any]:
    """Everything that the files say: what was run, pooled scores with intervals, verdicts, scores of clips."""
    printed = {row.name: row.paper for row in table.rows}
    trainings = [one for row in rows for run in row["runs"] for one in run["trainings"]]
    used = {*table.tests, *(name for one in trainings for name in one["sets"])}
    groups = (ALL,) if table.pooled else table.tests
    verdicts = judge(table.claims, {row["name"]: row for row in rows}, seed)
    return {
        "format": FORMAT,
        "version": 1,
        "table": table.name,
        "title": table.title,
        "size": size.name,
        "seed": seed,
        "command": command,
        "commit": git_commit(),
        "data": {name: text for name, text in catalogue.describe().items() if name in used},
        "is_open": catalogue.is_open,
        "tests": list(table.tests),
        "clips": asdict(table.view),
        "notes": list(table.notes),
        "metrics": [
            {"metric": name, "title": title_of(name), "unit": unit_of(name)}
            for name in table.metrics
        ],
        "groups": list(groups),
        "rows": [
            {
                "name": row["name"],
                "paper": {k: dict(v) for k, v in printed.get(row["name"], {}).items()},
                "scores": {group: _pooled(row, group, table.metrics, seed) for group in groups},
                "runs": [
                    {
                        "trainings": run["trainings"],
                        "commit": run.get("commit"),
                        "fingerprints": run.get("fingerprints"),
                        "predictions": run.get("predictions"),
                        "means": {g: _means(run, g, table.metrics) for g in groups},
                        "clips": _rounded(run["scores"]),
                    }
                    for run in row["runs"]
                ],
            }
            for row in rows
        ],
        "claims": [verdict.to_dict() for verdict in verdicts],
    }


def markdown(result: Mapping[str, Any]) -> str:
    """The table for people to read; ends with the paper's claims and what became of them."""
    parts = [f"# {result['title']}", _heading(result)]
    for group in result["groups"]:
        name = "" if group == ALL else f"## Tested on {group}\n\n"
        parts.append(name + _scores(result, group))
    parts.append(f"![{result['title']}]({result['table']}.png)")
    parts.append("## Trainings\n\n" + _trainings(result))
    parts.append("## Claims of the paper\n\n" + _claims(result))
    return "\n\n".join(parts) + "\n"


def _heading(result: Mapping[str, Any]) -> str:
    data = [f"{name}: {source}" for name, source in result["data"].items()]
    where = (
        "**Different data:** parts of the open corpus stand for the paper's datasets, so compare rows with one "
        "another, not with the paper's numbers, which stand beside them."
        if result["is_open"]
        else "The paper's numbers stand beside ours; splits and masks may differ."
    )
    lines = [
        where,
        f"- command: `{result['command']}`",
        f"- size {result['size']}, seeds {', '.join(map(str, _seeds(result)))}, commit {result['commit'][:12]}; "
        "all rows of a stage take the same number of steps",
        f"- data: {'; '.join(data)}",
        f"- scored on {', '.join(result['tests'])}: test split, faces and meshings that no row was trained on"
        if result["is_open"]
        else f"- scored on {', '.join(result['tests'])}: test split",
        "- [low, high]: 95 % bootstrap interval (BCa) over the test split's speakers, or its takes where there are few; lower is better, FDD nearer to 0, diversity higher",
        *(f"- {note}" for note in result["notes"]),
    ]
    return lines[0] + "\n\n" + "\n".join(lines[1:])


def _seeds(result: Mapping[str, Any]) -> list[int]:
    runs = [run for row in result["rows"] for run in row["runs"]]
    return sorted({one["seed"] for run in runs for one in run["trainings"]}) or [result["seed"]]


def _scores(result: Mapping[str, Any], group: str) -> str:
    shown = result["metrics"]
    header = ["row", *(f"{m['title']}{_unit(m['unit'])}" for m in shown)]
    single = _single_paper_metric(result, group)
    if single:
        header.append(f"paper's {single['title']} (other data)")
    several = any(len(row["runs"]) > 1 for row in result["rows"])
    if several:
        header.append(f"{shown[0]['title']} by seed")
    best = _best(result, group)
    lines = []
    for row in result["rows"]:
        scores = row["scores"][group]
        cells = [row["name"]]
        for m in shown:
            text = _interval(scores.get(m["metric"]))
            cells.append(f"**{text}**" if best.get(m["metric"]) == row["name"] else text)
        paper = row["paper"].get(group, {})
        if single:
            value = paper.get(single["metric"])
            cells.append("" if value is None else f"{value:g}")
        if several:
            own = [run["means"][group].get(shown[0]["metric"]) for run in row["runs"]]
            cells.append(", ".join(number(v, 3) for v in own) if len(own) > 1 else "")
        lines.append(cells)
        if paper and not single:
            printed = [paper.get(m["metric"]) for m in shown]
            shares = ["" if v is None else f"*{v:g}*" for v in printed]
            lines.append(["*paper, other data*", *shares, *([""] if several else [])])
    return _grid(header, lines) + (_orders(result, group, single) if single else "")


def _orders(result: Mapping[str, Any], group: str, metric: Mapping[str, str]) -> str:
    """The rows from the least value to the most, here and in the paper."""
    key = metric["metric"]
    rows = [row for row in result["rows"] if key in row["paper"].get(group, {})]
    here = sorted(rows, key=lambda row: row["scores"][group][key]["mean"])
    paper = sorted(rows, key=lambda row: row["paper"][group][key])
    names = [" < ".join(row["name"] for row in order) for order in (here, paper)]
    return f"\n\n{metric['title']} here: {names[0]}.\n\nIn the paper: {names[1]}."


def _trainings(result: Mapping[str, Any]) -> str:
    lines = []
    for row in result["rows"]:
        runs = row["runs"]
        for at, one in enumerate(runs[0]["trainings"]):
            seeds = ", ".join(str(run["trainings"][at]["seed"]) for run in runs)
            lines.append(
                [
                    row["name"],
                    one["kind"],
                    ", ".join(one["sets"]),
                    f"{_clips(one['data'])}",
                    f"{one['steps']}",
                    f"{one['parameters']:,}",
                    seeds,
                    f"`{' '.join([one['config'], *one['overrides']])}`",
                ]
            )
        if runs[0]["predictions"]:
            lines.append([row["name"], "predictions", *[""] * 5, f"`{runs[0]['predictions']}`"])
    header = ["row", "stage", "datasets", "clips", "steps", "parameters", "seeds", "configuration"]
    return _grid(header, lines)


def _claims(result: Mapping[str, Any]) -> str:
    if not result["claims"]:
        return "The rows that the paper compares are not all here."
    lines = [
        [
            claim["claim"],
            claim["source"],
            f"**{claim['outcome']}**",
            f"{_percent(claim['difference'])} [{_percent(claim['low'])}, {_percent(claim['high'])}]",
            "" if claim["margin"] else f"{max(claim['p_value'], 1e-4):.2g}",
            f"{claim['clips']} of {claim['drawn']['count']} {claim['drawn']['what']}",
        ]
        for claim in result["claims"]
    ]
    header = ["claim", "in the paper", "here", "difference", "p", "clips"]
    spreads = {claim["metric"]: claim["seed_spread"] for claim in result["claims"]}
    shown = [f"{title_of(name)} {100 * spread:.1f} %" for name, spread in spreads.items() if spread]
    seeds = (
        "Both include what other seeds change; standard deviation of a row's mean over seeds, pooled: "
        f"{', '.join(shown)}."
        if shown
        else "Each row is one training: neither includes what another seed changes."
    )
    footer = (
        "Difference: of the first from the second, relative to the second, paired by clip, with its 95 % "
        "interval. p: that the order is the other, by the same draws as the interval, Holm-corrected over "
        "the table. A claim held where the whole interval is on its side, p is below 0.05 and each row has "
        f"at least {MIN_SEEDS} trainings. {seeds}"
    )
    return _grid(header, lines) + "\n\n" + textwrap.fill(footer, 110)


def _pooled(
    row: RowResult, group: str, names: Sequence[str], seed: int
) -> dict[str, dict[str, Any]]:
    tests = {test: own for test, own in row["scores"].items() if group in (ALL, test)}
    clips = [(test, clip) for test, own in tests.items() for clip in own["frames"]]
    _, clusters = clusters_of(origins_of(row, clips))
    found = {}
    for name in names:
        values = {
            (test, clip): value
            for test, own in tests.items()
            for clip, value in own["values"].get(name, {}).items()
        }
        by_frames = pooling_of(name) == "frames"
        weights = {(t, c): float(tests[t]["frames"][c]) if by_frames else 1.0 for t, c in values}
        if values:
            drawn, means, sums = cluster_means(values, weights, clusters)
            interval = metrics.bootstrap_mean(means, sums, seed=seed)
            several = len(drawn) > 1
            found[name] = {
                "mean": interval.mean,
                "low": interval.low if several else None,
                "high": interval.high if several else None,
                "clips": len(values),
                "drawn": len(drawn),
            }
    return found


def _means(run: RowResult, group: str, names: Sequence[str]) -> dict[str, float]:
    """Means of one run, without intervals."""
    found = {}
    for name in names:
        pairs = [
            (value, scores["frames"][clip] if pooling_of(name) == "frames" else 1)
            for test, scores in run["scores"].items()
            if group in (ALL, test)
            for clip, value in scores["values"].get(name, {}).items()
        ]
        if pairs:
            found[name] = sum(v * w for v, w in pairs) / sum(w for _, w in pairs)
    return found


def _rounded(scores: Mapping[str, Any]) -> dict[str, Any]:
    return {
        test: {
            "frames": own["frames"],
            "origins": own.get("origins", {}),
            "values": {
                metric: {clip: float(f"{value:.{_DIGITS}g}") for clip, value in values.items()}
                for metric, values in own["values"].items()
            },
        }
        for test, own in scores.items()
    }


def _single_paper_metric(result: Mapping[str, Any], group: str) -> dict[str, str] | None:
    """The one metric that the paper prints, where it prints one: it gets a column instead of rows."""
    named = {m for row in result["rows"] for m in row["paper"].get(group, {})}
    if len(named) != 1:
        return None
    return next(dict(m) for m in result["metrics"] if m["metric"] in named)


def _best(result: Mapping[str, Any], group: str) -> dict[str, str]:
    """The row with the best mean of each metric, among those that predict something."""
    best = {}
    for m in result["metrics"]:
        means = {
            row["name"]: abs(row["scores"][group][m["metric"]]["mean"])
            for row in result["rows"]
            if m["metric"] in row["scores"][group] and not is_still(row)
        }
        if len(means) > 1:
            choose = max if m["metric"] == DIVERSITY else min
            best[m["metric"]] = choose(means, key=lambda name: means[name])
    return best


def _clips(data: Mapping[str, Any]) -> int:
    parts = data.get("datasets", {"": data})
    return sum(part["clips"]["train"] for part in parts.values())


def _interval(score: Mapping[str, Any] | None) -> str:
    if score is None:
        return "–"
    mean = number(score["mean"], 3)
    if score["low"] is None:
        return mean
    return f"{mean} [{number(score['low'], 3)}, {number(score['high'], 3)}]"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:+.1f} %"


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" ({unit.replace('^2', '²')})"


def _grid(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [header, ["---"] * len(header), *lines]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)
