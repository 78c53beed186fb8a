"""Ambient occlusion of the resting face, baked once: creases, nostrils and the mouth's inside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pyvista


def bake_occlusion(
    mesh: pyvista.PolyData, num_directions: int = 40, resolution: int = 256
) -> NDArray[np.float32]:
    """Share of the surrounding light that reaches each vertex.

    The mesh is drawn from directions spread over the sphere; a vertex is lit from a direction if
    the depth map there shows nothing nearer. Directions weigh by the cosine to its normal.

    Args:
        mesh: Triangles with point normals.
        num_directions: Directions, spread as a Fibonacci lattice.
        resolution: Side of each depth map in pixels.

    Returns:
        (V,) in [0, 1]; 1 sees the whole sky.
    """
    import pyvista

    points = np.asarray(mesh.points, dtype=np.float64)
    normals = np.asarray(mesh.point_data.active_normals, dtype=np.float64)
    center = (points.min(0) + points.max(0)) / 2
    radius = float(np.linalg.norm(points - center, axis=1).max()) or 1.0
    plotter = pyvista.Plotter(off_screen=True, window_size=[resolution, resolution])
    plotter.render_window.SetMultiSamples(0)
    plotter.add_mesh(mesh, color="white", lighting=False, copy_mesh=True)
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = radius
    lit, weight = np.zeros(len(points)), np.zeros(len(points))
    try:
        plotter.show(auto_close=False, interactive=False)
        for direction in sphere_directions(num_directions):
            cosine = np.maximum(normals @ direction, 0.0)
            lit += cosine * _visible(plotter, points, center, radius, direction)
            weight += cosine
    finally:
        plotter.close()
    return np.asarray(lit / np.maximum(weight, 1e-9), dtype=np.float32)


def sphere_directions(count: int) -> NDArray[np.float64]:
    """(count, 3) unit vectors, evenly over the sphere (a Fibonacci lattice)."""
    index = np.arange(count) + 0.5
    height = 1 - 2 * index / count
    angle = np.pi * (1 + np.sqrt(5)) * index
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(angle), height, ring * np.sin(angle)], axis=1)


def _visible(
    plotter: pyvista.Plotter,
    points: NDArray[np.float64],
    center: NDArray[np.float64],
    radius: float,
    direction: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(V,) 1 where nothing lies between a vertex and the far end of ``direction``."""
    up = np.array([0.0, 1.0, 0.0]) if abs(direction[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    up = np.cross(direction, right)
    camera = plotter.camera
    camera.position = tuple(center + 2 * radius * direction)
    camera.focal_point = tuple(center)
    camera.up = tuple(up)
    camera.clipping_range = (0.9 * radius, 3.1 * radius)
    plotter.render()
    depth = depth_map(plotter) * 2.2 * radius + 0.9 * radius
    height, width = depth.shape
    offset = points - center
    column = np.clip((offset @ right / radius + 1) / 2 * width, 0, width - 1).astype(int)
    row = np.clip((offset @ up / radius + 1) / 2 * height, 0, height - 1).astype(int)
    bias = 0.012 * radius
    return np.asarray(2 * radius - offset @ direction <= depth[row, column] + bias, dtype=float)


def depth_map(plotter: pyvista.Plotter) -> NDArray[np.float64]:
    """(height, width) depth in [0, 1] between the clipping planes, first row at the bottom."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkFloatArray

    window = plotter.render_window
    width, height = window.GetSize()
    buffer = vtkFloatArray()
    window.GetZbufferData(0, 0, width - 1, height - 1, buffer)
    return np.asarray(vtk_to_numpy(buffer), dtype=np.float64).reshape(height, width)
