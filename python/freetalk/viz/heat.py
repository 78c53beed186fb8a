"""A face coloured by a number at each vertex, such as an error or an attention weight."""

from __future__ import annotations

import os
from collections.abc import Sequence as Listing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.viz.pictures import save_image
from freetalk.viz.renderer import FaceRenderer, Image, View
from freetalk.viz.sequence import Sequence

#: Of matplotlib; dark is low.
COLORS = "turbo"
_MARK_RADIUS_M = 0.002


def heat_map(
    vertices: NDArray[np.floating[Any]],
    faces: NDArray[np.integer[Any]],
    values: NDArray[np.floating[Any]],
    limits: tuple[float, float],
    size: tuple[int, int] = (480, 480),
    view: View | None = None,
    mark: NDArray[np.floating[Any]] | None = None,
) -> Image:
    """Draws a mesh with a colour for each vertex's value.

    Args:
        vertices: (V, 3) points in metres, +Y up, +Z out of the face.
        faces: (F, 3) triangles.
        values: (V,) numbers.
        limits: values of the first and the last colour; others are clamped.
        size: (width, height) in pixels.
        view: camera and look.
        mark: (3,) where a white ball of 2 mm shows a place on the surface.

    Returns:
        (height, width, 3) uint8.

    Raises:
        ValueError: as many values as vertices are needed, and limits that rise.
        RuntimeError: no off-screen OpenGL could be started.
    """
    import matplotlib
    import pyvista

    points = np.asarray(vertices, dtype=np.float32)
    if np.shape(values) != (len(points),):
        raise ValueError(f"values must be ({len(points)},), found {np.shape(values)}")
    low, high = limits
    if not low < high:
        raise ValueError(f"limits must rise, found {low:g} and {high:g}")
    shares = np.clip((np.asarray(values, dtype=np.float64) - low) / (high - low), 0, 1)
    colors = matplotlib.colormaps[COLORS](shares)[:, :3]
    still = Sequence(
        points, np.asarray(faces, dtype=np.int64), np.zeros((1, *points.shape), np.float32), 1.0
    )
    still.located = True
    with FaceRenderer(
        still, size, view or View(yaw_deg=0.0, occlusion=False, fill_openings=False)
    ) as renderer:
        renderer.paint(colors)
        if mark is not None:
            ball = pyvista.Sphere(
                radius=_MARK_RADIUS_M, center=tuple(np.asarray(mark, dtype=float))
            )
            renderer.plotter.add_mesh(ball, color="white", lighting=False)
        return renderer.image(points)


def heat_sheet(
    images: Listing[Image],
    titles: Listing[str],
    path: str | os.PathLike[str],
    limits: tuple[float, float],
    label: str,
    columns: int = 4,
) -> Path:
    """Writes heat maps side by side with one colour bar as a PNG.

    Args:
        images: (height, width, 3) uint8 each.
        titles: one an image.
        path: where to write.
        limits: values of the first and the last colour.
        label: what the colours say, with its unit.
        columns: most images in a row.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    if not images or len(images) != len(titles):
        raise ValueError(
            f"images and titles must be as many, found {len(images)} and {len(titles)}"
        )
    across = min(columns, len(images))
    down = -(-len(images) // across)
    figure = Figure(figsize=(2.3 * across + 0.9, 2.45 * down), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(down, across, squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    for axis, image, title in zip(axes.flat, images, titles, strict=False):
        axis.imshow(image)
        axis.set_title(title, fontsize=8)
    bar = figure.colorbar(ScalarMappable(Normalize(*limits), COLORS), ax=axes, shrink=0.8, pad=0.02)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7)
    figure.set_dpi(130)
    canvas.draw()
    return save_image(np.asarray(canvas.buffer_rgba())[..., :3], path)
