"""Heads as scans have them: the built-in head with its lips sewn into one closed skin."""

from __future__ import annotations

import numpy as np

from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.mesh import boundary_loops


def _mouth(vertices: np.ndarray, faces: np.ndarray, middle: np.ndarray) -> list[int]:
    loops = boundary_loops(faces.tolist())
    return min(loops, key=lambda loop: float(np.linalg.norm(vertices[loop].mean(axis=0) - middle)))


def sewn_head(seed: int | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3) m, faces (F, 3), landmarks (68, 3): the inside of the mouth goes, the rims are joined.

    Args:
        seed: of the identity; None: the mean face.
    """
    model, count = load_face_model(), EXTENTS["head"]
    vertices = model.neutral[:count].astype(np.float64)
    if seed is not None:
        weights = 0.8 * np.random.default_rng(seed).standard_normal(len(model.identity_basis))
        vertices += np.tensordot(weights, model.identity_basis[:, :count], axes=1)
    faces = triangulate(crop_quads(model, "head")).astype(np.int64)
    marks = vertices[model.landmarks68]
    middle = marks[60:68].mean(axis=0)
    rings = np.full(count, 99)
    rings[_mouth(vertices, faces, middle)] = 0
    for ring in range(1, 12):
        around = faces[(rings[faces] == ring - 1).any(axis=1)].ravel()
        rings[around[rings[around] > ring]] = ring
    inner = min(rings[model.landmarks68[[62, 66]]])
    faces = faces[(rings[faces] >= inner).all(axis=1)]
    loop = _mouth(vertices, faces, middle)
    loop = np.roll(loop, -int(np.argmin(vertices[loop, 0]))).tolist()
    left = int(np.argmax(vertices[loop, 0]))
    upper, lower = loop[: left + 1], [loop[0], *loop[: left - 1 : -1]]
    seam, i, j = [], 0, 0
    while i + 1 < len(upper) or j + 1 < len(lower):
        further = j + 1 == len(lower) or (
            i + 1 < len(upper) and vertices[upper[i + 1], 0] <= vertices[lower[j + 1], 0]
        )
        if further:
            triangle = (upper[i + 1], upper[i], lower[j])
            i += 1
        else:
            triangle = (lower[j], lower[j + 1], upper[i])
            j += 1
        if len(set(triangle)) == 3:
            seam.append(triangle)
    faces = np.concatenate([faces, np.array(seam)])
    used = np.unique(faces)
    new = np.full(count, -1)
    new[used] = np.arange(len(used))
    return vertices[used], new[faces], marks
