"""Still pictures: single frames, contact sheets with the sound's waveform, landmark plots."""

from __future__ import annotations

import os
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from freetalk import _native
from freetalk._files import replacing
from freetalk.viz.renderer import FaceRenderer, Image, View
from freetalk.viz.sequence import Sequence, as_sequence

if TYPE_CHECKING:
    from PIL import Image as PillowImage

_BACKGROUND = (24, 28, 33)
_TEXT = (232, 234, 237)
_WAVE = (132, 170, 214)
_MARK = (240, 196, 120)
_GAP = 4
_LANDMARKS = _native.core.NUM_LANDMARKS

# iBUG contours, as runs of landmark indices; closed ones end where they begin.
_CONTOURS: tuple[tuple[int, ...], ...] = (
    tuple(range(17)),
    tuple(range(17, 22)),
    tuple(range(22, 27)),
    tuple(range(27, 31)),
    tuple(range(31, 36)),
    (*range(36, 42), 36),
    (*range(42, 48), 42),
    (*range(48, 60), 48),
    (*range(60, _LANDMARKS), 60),
)


def render_frame(
    animation: Any,
    time_s: float = 0.0,
    size: tuple[int, int] = (720, 720),
    view: View | None = None,
) -> Image:
    """Draws one moment of an animation.

    Args:
        animation: ``freetalk.Animation``, :class:`Sequence` or path of an animation ``.npz``.
        time_s: Moment in seconds, clamped to the animation.
        size: (width, height) in pixels.
        view: Camera and look.

    Returns:
        (height, width, 3) uint8.
    """
    return render_frames(animation, [time_s], size, view)[0]


def render_frames(
    animation: Any,
    times_s: Iterable[float],
    size: tuple[int, int] = (720, 720),
    view: View | None = None,
) -> list[Image]:
    """Draws several moments of an animation; see :func:`render_frame`."""
    sequence = as_sequence(animation)
    with FaceRenderer(sequence, size, view) as renderer:
        return [renderer.image(sequence.at_time(time), sequence.head_at(time)) for time in times_s]


def save_image(image: Image, path: str | os.PathLike[str]) -> Path:
    """Writes an image as PNG, atomically."""
    from PIL import Image as pillow

    buffer = BytesIO()
    pillow.fromarray(image).save(buffer, format="PNG")
    return _write_atomic(Path(path), buffer.getvalue())


def contact_sheet(
    rows: Iterable[Any],
    labels: Iterable[str],
    path: str | os.PathLike[str],
    times_s: Iterable[float] | None = None,
    num_columns: int = 8,
    cell: int = 240,
    view: View | None = None,
    waveform: bool = True,
) -> Path:
    """Writes a PNG with one animation a row and one moment a column.

    Args:
        rows: Animations, or lists of (h, w, 3) uint8 images of one size.
        labels: One a row.
        path: Where to write the PNG.
        times_s: Moments of the columns; spread over the first animation by default.
        num_columns: Number of columns when ``times_s`` is not given.
        cell: Side of a picture in pixels, for animations.
        view: Camera and look.
        waveform: Draws the first animation's sound below, with the moments marked.

    Returns:
        The path written.
    """
    rows, labels = list(rows), list(labels)
    if not rows or len(rows) != len(labels):
        raise ValueError(f"rows and labels must be as many, found {len(rows)} and {len(labels)}")
    drawn = [row for row in rows if not isinstance(row, list | tuple)]
    sound = as_sequence(drawn[0]) if drawn else None
    times = _column_times(sound, times_s, num_columns)
    images = [
        list(row)
        if isinstance(row, list | tuple)
        else render_frames(row, times, (cell, cell), view)
        for row in rows
    ]
    strip = sound if sound is not None and waveform and len(sound.samples) else None
    sheet = _compose(images, labels, times, strip)
    return save_image(np.asarray(sheet), path)


def landmark_plot(
    landmarks: NDArray[np.floating[Any]],
    path: str | os.PathLike[str],
    fps: float = 30.0,
    frames: Iterable[int] | None = None,
    title: str = "",
) -> Path:
    """Writes a PNG of 68 landmarks seen from the front, and of the inner-lip opening over time.

    Args:
        landmarks: (T, 68, 3) positions in metres, +Y up, +X the subject's left.
        path: Where to write the PNG.
        fps: Frames per second.
        frames: Frames to draw; by default the most closed, a middle and the most open one.
        title: Heading.

    Returns:
        The path written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    points = np.asarray(landmarks, dtype=np.float64)
    if points.ndim != 3 or points.shape[1:] != (_LANDMARKS, 3) or len(points) == 0:
        raise ValueError(
            f"landmarks must be (T, {_LANDMARKS}, 3) with at least one frame, found {points.shape}"
        )
    opening_mm = 1000 * np.linalg.norm(points[:, 62] - points[:, 66], axis=1)
    order = np.argsort(opening_mm)
    chosen = list(frames) if frames is not None else [order[0], order[len(order) // 2], order[-1]]
    figure = Figure(figsize=(9, 4), layout="constrained")
    FigureCanvasAgg(figure)
    face, curve = figure.subplots(1, 2, width_ratios=(1, 1.6))
    for frame in chosen:
        color = None
        for contour in _CONTOURS:
            xy = 1000 * points[frame, list(contour), :2]
            color = face.plot(xy[:, 0], xy[:, 1], color=color, marker=".", markersize=3)[
                0
            ].get_color()
        curve.axvline(frame / fps, color=color, linewidth=1)
    face.set(aspect="equal", xlabel="mm", ylabel="mm")
    curve.plot(np.arange(len(points)) / fps, opening_mm, color="0.2")
    curve.set(xlabel="s", ylabel="inner-lip opening, mm", title=title)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    return _write_atomic(Path(path), buffer.getvalue())


def _column_times(
    sequence: Sequence | None, times_s: Iterable[float] | None, num_columns: int
) -> list[float]:
    if times_s is not None:
        return [float(time) for time in times_s]
    if sequence is None:
        return []
    return [(k + 0.5) / num_columns * sequence.duration_s for k in range(num_columns)]


def _compose(
    images: list[list[Image]], labels: list[str], times: list[float], sound: Sequence | None
) -> PillowImage.Image:
    from PIL import Image as pillow
    from PIL import ImageDraw, ImageFont

    height, width = images[0][0].shape[:2]
    columns = max(len(row) for row in images)
    if columns == 0 or any(image.shape != images[0][0].shape for row in images for image in row):
        raise ValueError("the pictures of a contact sheet must all have one size")
    text_size = max(12, height // 14)
    font = ImageFont.load_default(size=text_size)
    left, top = 6 * text_size, int(1.7 * text_size)
    below = height // 3 if sound is not None else 0
    total = (left + columns * (width + _GAP), top + len(images) * (height + _GAP) + below)
    sheet = pillow.new("RGB", total, _BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for column, time in enumerate(times):
        center = left + column * (width + _GAP) + width // 2
        draw.text((center, top // 2), f"{time:.2f} s", _TEXT, font=font, anchor="mm")
    for row, (line, label) in enumerate(zip(images, labels)):
        y = top + row * (height + _GAP)
        draw.text(
            (left // 2, y + height // 2), label, _TEXT, font=font, anchor="mm", align="center"
        )
        for column, image in enumerate(line):
            sheet.paste(pillow.fromarray(image), (left + column * (width + _GAP), y))
    if sound is not None:
        _draw_wave(draw, sound, times, (left, total[1] - below, total[0] - _GAP, total[1]))
    return sheet


def _draw_wave(
    draw: Any, sound: Sequence, times: list[float], box: tuple[int, int, int, int]
) -> None:
    left, top, right, bottom = box
    middle, half = (top + bottom) / 2, 0.42 * (bottom - top)
    edges = np.linspace(0, len(sound.samples), right - left + 1).astype(int)
    loudest = float(np.abs(sound.samples).max()) or 1.0
    for x in range(right - left):
        chunk = sound.samples[edges[x] : max(edges[x + 1], edges[x] + 1)]
        high, low = half * chunk.max() / loudest, half * chunk.min() / loudest
        draw.line([(left + x, middle - high), (left + x, middle - low)], fill=_WAVE)
    length_s = len(sound.samples) / sound.sample_rate_hz
    for time in times:
        mark = left + (right - left) * time / length_s
        draw.line([(mark, top + 4), (mark, bottom - 4)], fill=_MARK, width=2)


def _write_atomic(path: Path, content: bytes) -> Path:
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path
