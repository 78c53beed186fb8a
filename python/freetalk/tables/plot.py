"""The plot of a table: rows down, the first metric with its interval across, the paper's numbers beside."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

_OURS, _THEIRS = "#2b6ca3", "#b9b9b9"


def draw(result: Mapping[str, Any], path: Path) -> None:
    """Writes a picture: one panel a test set, and one of the paper's numbers, which are of other data.

    Args:
        result: of a table.
        path: a ``.png``.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    metric = result["metrics"][0]
    rows, groups = result["rows"][::-1], result["groups"]
    names = [row["name"] for row in rows]
    panels = [(group, False) for group in groups]
    panels += [(group, True) for group in groups if any(row["paper"].get(group) for row in rows)]
    figure, axes = pyplot.subplots(
        1,
        len(panels),
        figsize=(2.2 + 2.6 * len(panels), 1.1 + 0.34 * len(rows)),
        sharey=True,
        squeeze=False,
    )
    for axis, (group, of_paper) in zip(axes[0], panels, strict=True):
        if of_paper:
            values = [row["paper"].get(group, {}).get(metric["metric"], 0.0) for row in rows]
            axis.barh(names, values, color=_THEIRS)
        else:
            scores = [row["scores"][group].get(metric["metric"]) for row in rows]
            axis.barh(names, [s["mean"] if s else 0.0 for s in scores], color=_OURS)
            for at, score in enumerate(scores):
                if score and score["low"] is not None:
                    axis.plot([score["low"], score["high"]], [at, at], color="black", linewidth=1)
        where = "" if group == "all" else f"{group}: "
        label = "paper, other data" if of_paper else f"{metric['unit'].replace('^2', '²')}, here"
        axis.set_title(f"{where}{metric['title']}, {label}", fontsize=8)
        axis.tick_params(labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
