"""Distances between faces of different meshings, whose vertices do not correspond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freetalk.geometry import SurfaceTree, sample_template

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
    return SurfaceTree(vertices, faces).nearest(points)[1]


@dataclass(frozen=True)
class SurfaceScores:
    """How near a reconstructed surface comes to the true one, as NPHM's and MonoNPHM's tables state it.

    Attributes:
        point_to_surface: mean distance of points of the true surface to the found one.
        chamfer_l1: mean of both directions' mean distance between sampled points.
        normal_consistency: mean of both directions' |cosine| of the normals of nearest points.
        f_scores: by threshold, the harmonic mean of the shares of points (of either surface) that have one of the
            other within it.
        sampling_floor: ``chamfer_l1`` of the true surface with itself, sampled twice: what it costs to sample.
    """

    point_to_surface: float
    chamfer_l1: float
    normal_consistency: float
    f_scores: dict[float, float]
    sampling_floor: float


def surface_scores(
    pred: tuple[Points, Faces],
    target: tuple[Points, Faces],
    *,
    thresholds: tuple[float, ...],
    num_points: int = 100_000,
    keep: Callable[[Points], npt.NDArray[np.bool_]] | None = None,
    seed: int = 0,
) -> SurfaceScores:
    """Scores of a reconstructed surface against the true one.

    Args:
        pred: vertices (V, 3) and triangles (F, 3).
        target: likewise; both lie in the same place and unit.
        thresholds: of the F-scores, in that unit.
        num_points: sampled on each surface.
        keep: which points (N, 3) count, such as those of the face; None keeps all.
        seed: of the samples.

    Raises:
        ValueError: a surface has no area, or none of its points counts.
    """
    from scipy.spatial import cKDTree  # of the extra [train]

    def sampled(mesh: tuple[Points, Faces], number: int) -> tuple[Points, Points]:
        points, normals = sample_template(*mesh, num_points, seed=seed + number)
        kept = np.ones(len(points), bool) if keep is None else keep(points)
        if not kept.any():
            raise ValueError("no point of the surface counts: keep leaves all of them out")
        return points[kept], normals[kept]

    (found, found_normals), (true, true_normals) = sampled(pred, 0), sampled(target, 1)
    to_true, nearest_true = cKDTree(true).query(found)
    to_found, nearest_found = cKDTree(found).query(true)
    again = sampled(target, 2)[0]
    floor = [cKDTree(true).query(again)[0].mean(), cKDTree(again).query(true)[0].mean()]
    cosines = [
        np.abs((found_normals * true_normals[nearest_true]).sum(axis=1)).mean(),
        np.abs((true_normals * found_normals[nearest_found]).sum(axis=1)).mean(),
    ]
    f_scores = {}
    for threshold in thresholds:
        precision, recall = (to_true <= threshold).mean(), (to_found <= threshold).mean()
        f_scores[threshold] = float(2 * precision * recall / max(precision + recall, 1e-12))
    return SurfaceScores(
        point_to_surface=float(_to_surface(true, *pred).mean()),
        chamfer_l1=float(0.5 * (to_true.mean() + to_found.mean())),
        normal_consistency=float(np.mean(cosines)),
        f_scores=f_scores,
        sampling_floor=float(np.mean(floor)),
    )
