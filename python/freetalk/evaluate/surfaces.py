"""Distances between faces of different meshings, whose vertices do not correspond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.floating]
Faces = npt.NDArray[np.integer]


@dataclass(frozen=True)
class SurfaceDistances:
    """How far two surfaces are apart, frame by frame.

    Attributes:
        chamfer: (T,) mean over vertices of the squared distance to the other's nearest vertex, both
            directions added: grows with coarseness, also where the surfaces are the same.
        point_to_surface: (T,) mean over vertices of the distance to the other's surface, mean of both
            directions.
        hausdorff: (T,) largest distance of a vertex of either to the other's surface.
    """

    chamfer: npt.NDArray[np.float64]
    point_to_surface: npt.NDArray[np.float64]
    hausdorff: npt.NDArray[np.float64]


def surface_distances(
    pred: Points, pred_faces: Faces, target: Points, target_faces: Faces
) -> SurfaceDistances:
    """Distances of two moving surfaces, whatever their vertices and triangles.

    Both must lie in the same place and unit: a face that was animated on another meshing of the same
    person, or a scan.

    Args:
        pred: (T, V, 3) vertices.
        pred_faces: (F, 3) triangles.
        target: (T, W, 3) vertices.
        target_faces: (G, 3) triangles.

    Returns:
        In the vertices' unit, ``chamfer`` in its square.

    Raises:
        ValueError: shapes or numbers of frames do not fit.
    """
    for name, points in (("pred", pred), ("target", target)):
        if points.ndim != 3 or points.shape[2] != 3 or points.size == 0:
            raise ValueError(f"{name} is {points.shape}, expected (T, V, 3)")
    if len(pred) != len(target):
        raise ValueError(f"{len(pred)} frames against {len(target)}")
    rows = [
        _distances(np.asarray(a, np.float64), pred_faces, np.asarray(b, np.float64), target_faces)
        for a, b in zip(pred, target)
    ]
    chamfer, mean, largest = np.array(rows).T
    return SurfaceDistances(chamfer, mean, largest)


def _distances(a: Points, a_faces: Faces, b: Points, b_faces: Faces) -> tuple[float, float, float]:
    from scipy.spatial import cKDTree  # of the extra [train]

    nearest = [cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]]
    chamfer = sum(float(np.square(own).mean()) for own in nearest)
    surface = [_to_surface(a, b, b_faces), _to_surface(b, a, a_faces)]
    mean = 0.5 * sum(float(own.mean()) for own in surface)
    return chamfer, mean, max(float(own.max()) for own in surface)


def _to_surface(points: Points, vertices: Points, faces: Faces) -> npt.NDArray[np.float64]:
    """Distance of each point to the nearest point of a surface, (N,)."""
    import pyvista

    sizes = np.full((len(faces), 1), 3)
    surface = pyvista.PolyData(vertices, np.hstack([sizes, faces]).ravel())
    _, closest = surface.find_closest_cell(points, return_closest_point=True)
    return np.linalg.norm(points - closest, axis=1)
