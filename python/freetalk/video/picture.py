"""Pictures of a fit: points tracked and fitted, and the mouth's opening and width over time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from freetalk._files import replacing
from freetalk.data.landmarks import lip_opening
from freetalk.video.fit import FittedClip, FittedTalker

_MOMENTS, _CLIPS = 4, 10
_TRACKED, _FITTED = "#9a9a9a", "#c8321e"


def save_fit_picture(talker: FittedTalker, path: Path) -> None:
    """Draws up to ten clips of a talker, tracked points in grey and fitted ones in red.

    Args:
        talker: what was fitted.
        path: a PNG to write.

    Raises:
        RuntimeError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise RuntimeError(
            "pictures of a fit need matplotlib: pip install 'freetalk[video]'"
        ) from error
    step = max(1, len(talker.clips) // _CLIPS)
    clips = talker.clips[::step][:_CLIPS]
    figure = Figure(figsize=(16, 2.1 * len(clips)), layout="constrained")
    rows = figure.subplots(
        len(clips), _MOMENTS + 1, squeeze=False, width_ratios=[1] * _MOMENTS + [5]
    )
    for clip, row in zip(clips, rows, strict=True):
        order = np.argsort(lip_opening(clip.landmarks))
        moments = np.sort(order[np.linspace(0, len(order) - 1, _MOMENTS).astype(int)])
        for axes, moment in zip(row, moments, strict=False):
            _faces(axes, clip, int(moment))
        _curves(row[-1], clip, moments / clip.track.fps)
    canvas = FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        canvas.print_figure(temporary, dpi=70)


def _faces(axes: Any, clip: FittedClip, frame: int) -> None:
    for points, colour in ((clip.track.points, _TRACKED), (clip.projected, _FITTED)):
        axes.plot(points[frame, :, 0], points[frame, :, 1], ".", color=colour, markersize=2.5)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _curves(axes: Any, clip: FittedClip, moments: Any) -> None:
    times = np.arange(len(clip.landmarks)) / clip.track.fps
    width = clip.landmarks[:, 54, 0] - clip.landmarks[:, 48, 0]
    seen = clip.width - np.median(clip.width - width)
    for curve, colour in ((clip.gap, _TRACKED), (lip_opening(clip.landmarks), _FITTED)):
        axes.plot(times, 1000 * curve, color=colour)
    for curve, colour in ((seen, _TRACKED), (width, _FITTED)):
        axes.plot(times, 1000 * curve - 12, color=colour, linestyle="--")
    axes.vlines(moments, -20, 0, color="#d8d8d8", linewidth=0.8)
    axes.set_title(
        f"{clip.track.name}: opening, mm; dashed: width, 12 mm lower", fontsize=8, loc="left"
    )
