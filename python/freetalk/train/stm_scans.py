"""Errors against scans: frames that are meshes of their own, of which points are known and no vertex is.

Which point belongs to which place of the moving face is found anew at every step, both ways: the place of its surface
nearest to each point of the scan, and the point of the scan nearest to each vertex. Nothing says how far a face slid
along itself; that is for the landmarks to tell, as in ScanTalk's training on unregistered meshes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from freetalk.data.landmarks import LIPS
from freetalk.geometry import SurfaceTree
from freetalk.mesh import vertex_normals

Faces = npt.NDArray[np.int64]

#: Pairs that are farther apart (mm) do not count: hair, floating bits, holes of the scan.
_REACH_MM = 20.0
#: Points of the lips lie this near to a landmark of theirs, and nearer than to any other (m).
_LIPS_M = 0.012


def chamfer_loss(moved: Tensor, faces: Faces, scans: Tensor) -> Tensor:
    """Mean squared distance of scans to a moving surface, plus that of its vertices to the scans along its normals.

    Along the normals, because the nearest of some points lies beside a vertex even where the surfaces are one.

    Args:
        moved: (T, V, 3) vertices, mm.
        faces: (F, 3) triangles.
        scans: (T, P, 3) points, mm.

    Returns:
        Scalar, mm^2; differentiable in `moved`.
    """
    terms = [_frame_loss(*pair, faces) for pair in zip(moved, scans, strict=True)]
    return torch.stack(terms).mean()


def _frame_loss(moved: Tensor, scan: Tensor, faces: Faces) -> Tensor:
    vertices = moved.detach().double().cpu().numpy()
    points = scan.double().cpu().numpy()
    found, _, hit = SurfaceTree(vertices, faces).nearest(points)
    corners = faces[hit.reshape(-1)]
    shares = torch.from_numpy(_shares(found, vertices[corners])).to(moved)
    places = (shares[..., None] * moved[torch.from_numpy(corners).to(moved.device)]).sum(dim=1)
    nearest = torch.from_numpy(cKDTree(points).query(vertices)[1]).to(moved.device)
    normals = torch.from_numpy(vertex_normals(vertices, faces)).to(moved)
    beside = moved - scan[nearest]
    along = (beside * normals).sum(dim=-1)
    return _mean((places - scan).square().sum(dim=-1)) + _mean(along.square(), beside)


def _mean(squares: Tensor, apart: Tensor | None = None) -> Tensor:
    """Of what is within reach."""
    far = squares if apart is None else apart.square().sum(dim=-1)
    counted = far.detach() <= _REACH_MM**2
    return (squares * counted).sum() / counted.sum().clamp_min(1)


def _shares(points: npt.NDArray[np.float64], corners: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    """Barycentric (P, 3) of points (P, 3) that lie on triangles (P, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    area = np.maximum(np.square(normal).sum(axis=1), 1e-30)
    second = (np.cross(points - a, c - a) * normal).sum(axis=1) / area
    third = (np.cross(b - a, points - a) * normal).sum(axis=1) / area
    return np.stack([1 - second - third, second, third], axis=1)


def scan_errors(
    moved: Tensor, rest: Tensor, faces: Faces, scans: Tensor, landmarks: Tensor
) -> list[float]:
    """How far scans are from a moved face, and from the face at rest.

    Args:
        moved: (T, V, 3) vertices, m.
        rest: (V, 3) vertices of the face at rest, m.
        faces: (F, 3) triangles.
        scans: (T, P, 3) points, m.
        landmarks: (T, 68, 3) where they are in each frame, m.

    Returns:
        Mean distances of points to the surface, m: moved, at rest, and likewise of the lips' points.
    """
    still = SurfaceTree(rest.double().cpu().numpy(), faces)
    rows = []
    for vertices, scan, marks in zip(moved, scans, landmarks, strict=True):
        points = scan.double().cpu().numpy()
        own = SurfaceTree(vertices.double().cpu().numpy(), faces).nearest(points)[1].reshape(-1)
        other = still.nearest(points)[1].reshape(-1)
        distance, nearest = cKDTree(marks.double().cpu().numpy()).query(points)
        lips = np.isin(nearest, list(LIPS)) & (distance < _LIPS_M)
        on_lips = [float(part[lips].mean()) if lips.any() else 0.0 for part in (own, other)]
        rows.append([float(own.mean()), float(other.mean()), *on_lips])
    return [float(value) for value in np.mean(rows, axis=0)]
