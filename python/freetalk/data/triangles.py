"""Places on triangles: by their corners and shares, and those nearest to points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Places:
    """Points that lie on the triangles of a meshing.

    Attributes:
        vertices: (N, 3) corners of the triangle that each lies on.
        weights: (N, 3) barycentric, sum 1.
    """

    vertices: npt.NDArray[np.int64]
    weights: Points

    def of(self, values: npt.NDArray[Any]) -> Points:
        """(..., N, C) of values (..., V, C) at the vertices."""
        corners = np.asarray(values, dtype=np.float64)[..., self.vertices, :]
        return np.asarray(np.einsum("...kcd,kc->...kd", corners, self.weights))


def closest_on_triangles(
    points: npt.NDArray[Any], corners: npt.NDArray[Any]
) -> tuple[Points, Points]:
    """The nearest place of each triangle to its point (Ericson, Real-Time Collision Detection, 5.1.5).

    Args:
        points: (N, 3), or one for all (3,).
        corners: (N, 3, 3) of the triangles.

    Returns:
        barycentric weights (N, 3) and squared distances (N,).
    """
    best, nearest = np.zeros((len(corners), 3)), np.full(len(corners), np.inf)

    def consider(weights: Points, valid: npt.NDArray[np.bool_] | bool = True) -> None:
        places = np.einsum("ncd,nc->nd", corners, weights)
        away = np.where(valid, np.square(points - places).sum(axis=1), np.inf)
        better = away < nearest
        best[better], nearest[better] = weights[better], away[better]

    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(1), (ab * ac).sum(1), (ac * ac).sum(1)
    d20, d21 = (ap * ab).sum(1), (ap * ac).sum(1)
    area = np.maximum(d00 * d11 - d01 * d01, 1e-30)
    v, w = (d11 * d20 - d01 * d21) / area, (d00 * d21 - d01 * d20) / area
    inside = np.stack([1 - v - w, v, w], axis=1)
    consider(inside, np.asarray((inside >= 0).all(axis=1)))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, edge = corners[:, first], corners[:, second] - corners[:, first]
        along = ((points - start) * edge).sum(1) / np.maximum((edge * edge).sum(1), 1e-30)
        weights = np.zeros((len(corners), 3))
        weights[:, second] = np.clip(along, 0, 1)
        weights[:, first] = 1 - weights[:, second]
        consider(weights)
    return best, nearest
