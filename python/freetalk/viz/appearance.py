"""How a face looks: smooth normals that follow the motion, and colours that tell parts apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freetalk.mesh import connected_components

SKIN = (0.86, 0.67, 0.56)
MOUTH_INSIDE = (0.36, 0.14, 0.13)
MOUTH_DARK = (0.13, 0.045, 0.045)
IVORY = (0.90, 0.88, 0.83)
GUMS = (0.62, 0.29, 0.29)
IRIS = (0.25, 0.36, 0.42)
PUPIL = (0.03, 0.03, 0.03)

# Where a part lies that is behind the lips, around the face's mean landmark, m: (low, high). Gums with a tongue are
# larger than this (m) in every direction, teeth are not.
_MOUTH_BOX = np.array([[-0.055, -0.09, -0.11], [0.055, 0.015, 0.03]])
_GUMS_M = 0.03
# Half angles of pupil and iris, seen from the centre of the eyeball.
_PUPIL_ANGLE = np.deg2rad(11.0)
_IRIS_ANGLE = np.deg2rad(28.0)
# Mean distance from an eyeball's centre, in radii, within which a small part belongs to the eye.
_EYE_REACH = 2.2


class NormalField:
    """Area-weighted vertex normals of a fixed triangulation."""

    def __init__(self, faces: NDArray[np.int64], num_vertices: int) -> None:
        """Keeps ``faces`` (F, 3) of ``num_vertices`` points."""
        self._faces = np.ascontiguousarray(faces)
        self._corner = self._faces.T.ravel()
        self._num_vertices = num_vertices

    def __call__(self, vertices: NDArray[np.float32]) -> NDArray[np.float32]:
        """Returns (V, 3) unit normals; a vertex without area looks along +Z."""
        a, b, c = (vertices[self._faces[:, k]] for k in range(3))
        area = np.tile(np.cross(b - a, c - a), (3, 1))
        normals = np.stack(
            [
                np.bincount(self._corner, weights=area[:, axis], minlength=self._num_vertices)
                for axis in range(3)
            ],
            axis=1,
        )
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))[:, None]
        normals = normals / np.maximum(length, 1e-20)
        normals[length[:, 0] < 1e-20] = (0.0, 0.0, 1.0)
        return normals.astype(np.float32)


def part_labels(faces: NDArray[np.int64], num_vertices: int) -> NDArray[np.int64]:
    """Numbers the connected parts of a mesh, the largest first.

    Args:
        faces: (F, 3) triangles.
        num_vertices: V.

    Returns:
        (V,) part of each vertex.
    """
    label = connected_components(num_vertices, faces)
    _, part, count = np.unique(label, return_inverse=True, return_counts=True)
    rank = np.empty(len(count), dtype=np.int64)
    rank[np.argsort(-count, kind="stable")] = np.arange(len(count))
    return rank[part]


def vertex_colors(vertices: NDArray[np.float32], faces: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Skin for the largest part, gums for what is behind its lips, ivory for the others, an iris on those that are eyeballs.

    Args:
        vertices: (V, 3) resting points, upright (+Z out of the face).
        faces: (F, 3) triangles.

    Returns:
        (V, 3) uint8 red, green, blue.
    """
    labels = part_labels(faces, len(vertices))
    colors = np.tile(np.asarray(IVORY), (len(vertices), 1))
    colors[labels == 0] = SKIN
    for label in range(1, labels.max(initial=0) + 1):
        part = labels == label
        low, high = vertices[part].min(axis=0), vertices[part].max(axis=0)
        inside = (low > _MOUTH_BOX[0]).all() and (high < _MOUTH_BOX[1]).all()
        if inside and (high - low).min() > _GUMS_M:
            colors[part] = GUMS
    balls, _ = _eyeballs(vertices, labels)
    for ball in balls:
        offsets = vertices[ball.chosen] - ball.center
        angle = np.arccos(
            np.clip(offsets[:, 2] / np.maximum(np.linalg.norm(offsets, axis=1), 1e-12), -1, 1)
        )
        colors[ball.chosen[angle < _IRIS_ANGLE]] = IRIS
        colors[ball.chosen[angle < _PUPIL_ANGLE]] = PUPIL
    return np.asarray(np.round(colors * 255), dtype=np.uint8)


def seen_faces(vertices: NDArray[np.float32], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles without what heads made for games have before their eyeballs and cut out with a texture.

    Those are clear sheets for tears and shadow, and strips for lashes: without their texture they hide the eyes.

    Args:
        vertices: (V, 3) resting points, upright.
        faces: (F, 3) triangles.

    Returns:
        (F', 3) triangles, those of a mesh without eyeballs all.
    """
    labels = part_labels(faces, len(vertices))
    balls, others = _eyeballs(vertices, labels)
    clear = [
        labels[chosen[0]]
        for chosen in others
        if any(
            len(chosen) < len(ball.chosen) and ball.reach(vertices[chosen]).mean() < _EYE_REACH
            for ball in balls
        )
    ]
    return faces[~np.isin(labels[faces[:, 0]], clear)]


@dataclass
class _Ball:
    chosen: NDArray[np.int64]
    center: NDArray[np.float64]
    radius: float

    def reach(self, points: NDArray[np.float32]) -> NDArray[np.float64]:
        """Distances from the centre, in radii."""
        return np.asarray(np.linalg.norm(points - self.center, axis=1) / self.radius)


def _eyeballs(
    vertices: NDArray[np.float32], labels: NDArray[np.int64]
) -> tuple[list[_Ball], list[NDArray[np.int64]]]:
    """The parts beside the largest: balls, and the vertices of each other part."""
    balls, others = [], []
    for part in range(1, labels.max(initial=0) + 1):
        chosen = np.flatnonzero(labels == part)
        ball = _fit_ball(vertices, chosen) if len(chosen) >= 40 else None
        if ball is None:
            others.append(chosen)
        else:
            balls.append(ball)
    return balls, others


def shade_colors(colors: NDArray[np.uint8], light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Darkens (V, 3) colours where little ``light`` (V,) in [0, 1] arrives, blue and green most.

    Light that reaches a crease of skin has bounced off skin, so what remains is reddish.
    """
    open_sky = np.clip(light / 0.9, 0, 1)[:, None]
    tinted = open_sky ** np.array([0.55, 0.8, 0.85])
    floor = np.array([0.22, 0.12, 0.11])
    return np.asarray(colors * (floor + (1 - floor) * tinted), dtype=np.uint8)


def _fit_ball(vertices: NDArray[np.float32], chosen: NDArray[np.int64]) -> _Ball | None:
    """The sphere on which the chosen vertices lie to within a few percent; None where they do not."""
    points = vertices[chosen].astype(np.float64)
    system = np.hstack([2 * points, np.ones((len(points), 1))])
    solution, _, rank, _ = np.linalg.lstsq(system, (points**2).sum(1), rcond=None)
    if rank < 4:
        return None
    center = solution[:3]
    radius = float(np.sqrt(max(solution[3] + center @ center, 0.0)))
    spread = float(np.mean(np.abs(np.linalg.norm(points - center, axis=1) - radius)))
    if radius <= 0 or spread > 0.06 * radius or np.ptp(points, axis=0).min() < radius:
        return None
    return _Ball(chosen, center, radius)
