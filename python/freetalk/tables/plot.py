"""The plot of a table: rows down, the first metric with its interval across, the paper's numbers beside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from freetalk.evaluate.writers import number

_OURS, _THEIRS, _RUNS = "#2b6ca3", "#b9b9b9", "#f0a030"


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Writes a picture: one panel a test set, and one of the paper's numbers, which are of other data.

    Bars are means over seeds and clips, lines their 95 % intervals over clips, dots single seeds. The face
    that does not move would dwarf the rest: it stands in the heading.

    Args:
        result: of a table.
        path: a ``.png``.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [row for row in result["rows"][::-1] if not is_still(row)] or result["rows"][::-1]
    groups, first = result["groups"], result["metrics"][0]["metric"]
    panels = [(group, False) for group in groups]
    panels += [
        (group, True)
        for group in groups
        if any(first in row["paper"].get(group, {}) for row in rows)
    ]
    size = (2.2 + 2.6 * len(panels), 1.2 + 0.34 * len(rows))
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axis, (group, of_paper) in zip(axes, panels, strict=True):
        if of_paper:
            _draw_paper(axis, result, rows, group)
        else:
            _draw_own(axis, result, rows, group)
        axis.tick_params(labelsize=8)
        axis.locator_params(axis="x", nbins=5)
        axis.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


def _draw_own(axis: Any, result: Mapping[str, Any], rows: list[Any], group: str) -> None:
    metric = result["metrics"][0]
    name = metric["metric"]
    scores = [row["scores"][group].get(name) for row in rows]
    axis.barh([row["name"] for row in rows], [s["mean"] if s else 0.0 for s in scores], color=_OURS)
    for at, (row, score) in enumerate(zip(rows, scores, strict=True)):
        if score and score["low"] is not None:
            axis.plot([score["low"], score["high"]], [at, at], color="black", linewidth=1)
        if len(row["runs"]) > 1:
            means = [run["means"][group][name] for run in row["runs"]]
            axis.plot(means, [at] * len(means), ".", color=_RUNS, markersize=4)
    unit = metric["unit"].replace("^2", "²")
    heading = f"{_where(group)}{metric['title']}, {unit}, here"
    still = next(
        (row["scores"][group][name]["mean"] for row in result["rows"] if is_still(row)), None
    )
    if still is not None:
        heading += f"\n(still face: {number(still, 3)})"
    axis.set_title(heading, fontsize=8)


def _draw_paper(axis: Any, result: Mapping[str, Any], rows: list[Any], group: str) -> None:
    metric = result["metrics"][0]
    values = [row["paper"].get(group, {}).get(metric["metric"], 0.0) for row in rows]
    axis.barh([row["name"] for row in rows], values, color=_THEIRS)
    axis.set_title(f"{_where(group)}{metric['title']},\npaper, other data", fontsize=8)


def _where(group: str) -> str:
    return "" if group == "all" else f"{group}: "


def is_still(row: Mapping[str, Any]) -> bool:
    """Whether a row has neither trainings nor predictions."""
    run = row["runs"][0]
    return not run["trainings"] and not run["predictions"]
