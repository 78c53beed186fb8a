"""Weights that carry what is known on a surface to the vertices of another meshing of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

Faces = npt.NDArray[np.int32]
FloatArray = npt.NDArray[np.float64]


def closest_on_triangles(
    points: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Closest points on triangles row by row (Ericson, Real-Time Collision Detection, 5.1.5).

    Returns:
        barycentric weights (N, 3) and squared distances (N,).
    """
    best = np.zeros((len(points), 3))
    best_d2 = np.full(len(points), np.inf)

    def consider(weights: FloatArray, valid: npt.NDArray[np.bool_]) -> None:
        at = weights[:, :1] * a + weights[:, 1:2] * b + weights[:, 2:] * c
        d2 = np.where(valid, ((points - at) ** 2).sum(1), np.inf)
        better = d2 < best_d2
        best[better], best_d2[better] = weights[better], d2[better]

    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(1), (ab * ac).sum(1), (ac * ac).sum(1)
    d20, d21 = (ap * ab).sum(1), (ap * ac).sum(1)
    denominator = np.maximum(d00 * d11 - d01 * d01, 1e-30)
    v = (d11 * d20 - d01 * d21) / denominator
    w = (d00 * d21 - d01 * d20) / denominator
    inside = np.stack([1 - v - w, v, w], 1)
    consider(inside, np.asarray((inside >= 0).all(axis=1)))
    always = np.ones(len(points), bool)
    for start, end, i, j in ((a, b, 0, 1), (b, c, 1, 2), (c, a, 2, 0)):
        edge = end - start
        t = ((points - start) * edge).sum(1) / np.maximum((edge * edge).sum(1), 1e-30)
        weights = np.zeros((len(points), 3))
        weights[:, j] = np.clip(t, 0, 1)
        weights[:, i] = 1 - weights[:, j]
        consider(weights, always)
    return best, best_d2


def carry_from_groups(
    points: FloatArray, source: FloatArray, faces: Faces, group: npt.NDArray[np.int64]
) -> sp.csr_matrix:
    """Barycentric carry of new points whose origin among the source vertices is known.

    Args:
        points: (P, 3) new positions.
        source: (V, 3) source vertices; faces: (F, 3) source triangles.
        group: (V,) index of the new point that each source vertex became, -1 for none.

    Returns:
        (P, V) sparse matrix, three weights a row.
    """
    corner_group = group[faces]
    triangle = np.repeat(np.arange(len(faces)), 3)
    pairs = np.unique(np.stack([corner_group.ravel(), triangle], 1), axis=0)
    pairs = pairs[pairs[:, 0] >= 0]
    target, triangle = pairs[:, 0], pairs[:, 1]
    a, b, c = (source[faces[triangle, k]] for k in range(3))
    weights, d2 = closest_on_triangles(points[target], a, b, c)
    order = np.lexsort((d2, target))
    first = np.unique(target[order], return_index=True)
    chosen = order[first[1]]
    if len(first[0]) != len(points):
        raise ValueError("a new vertex has no source vertex")
    rows = np.repeat(np.arange(len(points)), 3)
    columns = faces[triangle[chosen]].ravel()
    shape = (len(points), len(source))
    return sp.csr_matrix((weights[chosen].ravel(), (rows, columns)), shape=shape)
