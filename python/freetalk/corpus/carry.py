"""Weights that carry what is known on a surface to the vertices of another meshing of it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from freetalk.data.triangles import closest_on_triangles

Faces = npt.NDArray[np.int32]
FloatArray = npt.NDArray[np.float64]


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
    weights, d2 = closest_on_triangles(points[target], source[faces[triangle]])
    order = np.lexsort((d2, target))
    first = np.unique(target[order], return_index=True)
    chosen = order[first[1]]
    if len(first[0]) != len(points):
        raise ValueError("a new vertex has no source vertex")
    rows = np.repeat(np.arange(len(points)), 3)
    columns = faces[triangle[chosen]].ravel()
    shape = (len(points), len(source))
    return sp.csr_matrix((weights[chosen].ravel(), (rows, columns)), shape=shape)
