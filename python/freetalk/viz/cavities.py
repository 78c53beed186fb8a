"""Stand-ins drawn where a face mesh is open: eyes behind open lids, a dark mouth between the lips.

They exist in pictures only; animations and exported meshes are never changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freetalk.mesh import connected_components
from freetalk.viz.appearance import IRIS, IVORY, PUPIL, part_labels

# Where the rims of mouth and eyes lie around the mean landmark of the mean face, metres: (low, high).
_MOUTH_BOX = np.array([[-0.02, -0.065, -0.02], [0.02, -0.012, 0.06]])
_EYE_BOX = np.array([[0.014, 0.0, -0.03], [0.052, 0.06, 0.05]])
_MOUTH_WIDTH = (0.025, 0.09)
_EYE_WIDTH = (0.015, 0.05)
# Metres that an eye lies behind the lids' margins, so that closed lids hide it.
_BEHIND_LIDS = 6e-4


@dataclass
class Mouth:
    """The rim of the open mouth: edges (E, 2) between vertices, closed by a fan to one deep point."""

    edges: NDArray[np.int64]
    depth: float

    def points(self, vertices: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns the fan's (2E + 1, 3) points: both ends of each edge, then the deep point."""
        rim = vertices[self.edges.ravel()]
        deep = rim.mean(0) - np.array([0, 0, self.depth], dtype=np.float32)
        return np.vstack([rim, deep]).astype(np.float32)

    def faces(self) -> NDArray[np.int64]:
        """Returns the fan's (E, 3) triangles."""
        first = np.arange(0, 2 * len(self.edges), 2)
        return np.stack([first, first + 1, np.full(len(first), 2 * len(self.edges))], axis=1)


@dataclass
class Eye:
    """A ball behind open lids."""

    center: NDArray[np.float64]
    radius: float


@dataclass
class Cavities:
    """Openings of one face."""

    eyes: list[Eye]
    mouth: Mouth | None


def find_cavities(vertices: NDArray[np.float32], faces: NDArray[np.int64]) -> Cavities:
    """Finds the open eyes and mouth of a resting face in the canonical frame.

    Args:
        vertices: (V, 3) metres, +Y up, +Z out of the face.
        faces: (F, 3) triangles.

    Returns:
        The openings of the largest part; none where the mesh is closed, where its rims lie elsewhere
        than those of a face, or where it brings eyes of its own.
    """
    found = Cavities(eyes=[], mouth=None)
    parts = part_labels(faces, len(vertices))
    others = [vertices[parts == part].mean(0) for part in range(1, parts.max(initial=0) + 1)]
    for edges in boundary_rims(faces[parts[faces[:, 0]] == 0], len(vertices)):
        rim = vertices[np.unique(edges)].astype(np.float64)
        middle, width = rim.mean(0), float(np.ptp(rim[:, 0]))
        mirrored = np.array([abs(middle[0]), middle[1], middle[2]])
        if _inside(middle, _MOUTH_BOX) and _MOUTH_WIDTH[0] < width < _MOUTH_WIDTH[1]:
            found.mouth = Mouth(edges=edges, depth=0.25 * width)
        elif _inside(mirrored, _EYE_BOX) and _EYE_WIDTH[0] < width < _EYE_WIDTH[1]:
            own_eye = any(np.linalg.norm(other - middle) < width for other in others)
            found.eyes += [] if own_eye else [_fit_eye(rim, 0.42 * width)]
    return found


def eye_colors(eye: Eye, points: NDArray[np.float32]) -> NDArray[np.uint8]:
    """(N, 3) uint8 colours of points on an eye that looks along +Z."""
    cosine = (points[:, 2] - eye.center[2]) / eye.radius
    colors = np.tile(np.asarray(IVORY), (len(points), 1))
    colors[cosine > np.cos(np.deg2rad(29))] = IRIS
    colors[cosine > np.cos(np.deg2rad(12))] = PUPIL
    return np.asarray(np.round(colors * 255), dtype=np.uint8)


def _inside(point: NDArray[np.float64], box: NDArray[np.float64]) -> bool:
    return bool((point >= box[0]).all() and (point <= box[1]).all())


def boundary_rims(faces: NDArray[np.int64], num_vertices: int) -> list[NDArray[np.int64]]:
    """Edges that only one triangle has, grouped by the rim they belong to.

    Args:
        faces: (F, 3) triangles.
        num_vertices: V.

    Returns:
        (E, 2) edges of each rim.
    """
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key = np.sort(edges, axis=1) @ np.array([num_vertices, 1])
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    boundary = edges[first[count == 1]]
    if len(boundary) == 0:
        return []
    label = connected_components(num_vertices, boundary[:, [0, 1, 1]])[boundary[:, 0]]
    return [boundary[label == value] for value in np.unique(label)]


def _fit_eye(rim: NDArray[np.float64], radius: float) -> Eye:
    """Ball of given radius just behind the lid margins: its surface is led through them by Gauss-Newton."""
    center = rim.mean(0) - np.array([0, 0, 0.8 * radius])
    for _ in range(20):
        offset = rim - center
        distance = np.linalg.norm(offset, axis=1)
        jacobian = -offset / distance[:, None]
        step = np.linalg.lstsq(jacobian, radius - distance, rcond=None)[0]
        center = center + np.clip(step, -0.3 * radius, 0.3 * radius)
    return Eye(center=center - np.array([0, 0, _BEHIND_LIDS]), radius=0.99 * radius)
