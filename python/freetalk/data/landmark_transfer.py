"""Proposes the 68 landmarks of a new template: a face model is fitted to it, its landmarks are carried over.

The template is first aligned with the model by a similarity (``freetalk.geometry.align_to_template``). The
model's identity then follows the template's surface: each round pairs samples of the model with the nearest
point of the template whose normal agrees, and solves for the identity coefficients and a small similarity by
point-to-plane least squares with a Gaussian prior, as in classical 3D-morphable-model fitting. The landmarks of
the fitted face go to the nearest place whose normal agrees, so closed lips and lids do not mix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from freetalk import geometry
from freetalk.data.triangles import Places, closest_on_triangles
from freetalk.mesh import vertex_normals

Points = npt.NDArray[np.float64]

_SAMPLES, _SURFACE_SAMPLES = 2500, 40000
_ROUNDS = 24
#: Largest distance of a pair (m) in the first and in the last round.
_REACH_M = (0.025, 0.006)
#: Assumed noise of the template's surface (m): what the prior is weighed against.
_NOISE_M = 0.0015
#: Share of the distance along the surface that counts beside the distance to it.
_SLIDE = 0.1
_SMALLEST_COSINE = 0.5
#: A vertex whose normal is at right angles counts as this much further away (m).
_NORMAL_COST_M = 0.006
#: A vertex of the template belongs to the face where the fitted model is nearer than this (m).
_NEAR_M = 0.008


@dataclass(frozen=True)
class LinearFace:
    """A face model: vertices = neutral + coefficients . identity_basis.

    Attributes:
        neutral: (N, 3) mean face, canonical frame, m.
        faces: (G, 3) triangles.
        identity_basis: (K, N, 3) modes of standard deviation 1, m.
        landmarks: (68,) vertices.
    """

    neutral: npt.NDArray[Any]
    faces: npt.NDArray[Any]
    identity_basis: npt.NDArray[Any]
    landmarks: npt.NDArray[np.integer[Any]]


@dataclass(frozen=True)
class Anchors(Places):
    """Points of the template whose places on the model are known.

    Attributes:
        positions: (N, 3) on the template, m.
        deviation_m: (N,) how far off they may be.
    """

    positions: Points
    deviation_m: Points


@dataclass(frozen=True)
class FaceFit:
    """The model on the template.

    Attributes:
        vertices: (N, 3) the fitted model, canonical frame, m.
        coefficients: (K,) of its identity.
        residual_m: median distance of the paired samples.
        paired: share of the samples that found a partner.
    """

    vertices: Points
    coefficients: Points
    residual_m: float
    paired: float


@dataclass(frozen=True)
class ProposedLandmarks:
    """Landmarks of a template.

    Attributes:
        triangles: (68,) of the template, which they lie on.
        weights: (68, 3) barycentric on them, sum 1.
        indices: (68,) the vertices that count most.
        positions: (68, 3) where they lie, canonical frame, m.
        distance_m: (68,) from the fitted model's landmarks.
        fit: the fitted model.
    """

    triangles: npt.NDArray[np.int64]
    weights: Points
    indices: npt.NDArray[np.int64]
    positions: Points
    distance_m: Points
    fit: FaceFit


def fit_face(
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    model: LinearFace,
    anchors: Anchors | None = None,
) -> FaceFit:
    """Fits a linear face model to an aligned template.

    Args:
        vertices: (V, 3) template in the canonical frame, m.
        faces: (F, 3) its triangles.
        model: the face model.
        anchors: points that are known already; they count beside the surface.

    Raises:
        ValueError: the surfaces are too far apart to be the same face.
    """
    from scipy.spatial import cKDTree

    surface, normals = geometry.sample_template(vertices, faces, _SURFACE_SAMPLES)
    tree = cKDTree(surface)
    used = np.unique(model.faces)
    chosen = used[:: max(1, len(used) // _SAMPLES)]
    modes = np.asarray(model.identity_basis[:, chosen], dtype=np.float64)  # (K, S, 3)
    rest = np.asarray(model.neutral, dtype=np.float64)
    held_modes = None if anchors is None else anchors.of(model.identity_basis)  # (K, N, 3)
    coefficients = np.zeros(len(modes))
    matrix, shift = np.eye(3), np.zeros(3)
    distance, kept = np.zeros(0), np.zeros(0, bool)
    for reach in np.geomspace(*_REACH_M, _ROUNDS):
        whole = rest + np.tensordot(coefficients, model.identity_basis, axes=1)
        own = vertex_normals(whole, model.faces)[chosen] @ matrix.T
        points = whole[chosen] @ matrix.T + shift
        _, nearest = tree.query(points)
        offset = points - surface[nearest]
        distance = np.linalg.norm(offset, axis=1)
        agree = (own * normals[nearest]).sum(axis=1)
        kept = (distance < reach) & (agree > _SMALLEST_COSINE * np.linalg.norm(own, axis=1))
        if kept.sum() < 100:
            raise ValueError(
                "the mesh and the built-in face hardly meet: is it a face in this pose and unit?"
            )
        on_surface = _surface_rows(
            points[kept], offset[kept], normals[nearest[kept]], modes[:, kept] @ matrix.T
        )
        held = None
        if anchors is not None and held_modes is not None:
            places = anchors.of(whole) @ matrix.T + shift
            held = _anchor_rows(places, anchors, held_modes @ matrix.T)
        step = _solve(on_surface, held, coefficients)
        coefficients = coefficients + step[7:]
        turn = (1 + step[6]) * Rotation.from_rotvec(step[:3]).as_matrix()
        matrix, shift = turn @ matrix, turn @ shift + step[3:6]
    fitted = (rest + np.tensordot(coefficients, model.identity_basis, axes=1)) @ matrix.T + shift
    return FaceFit(fitted, coefficients, float(np.median(distance[kept])), float(kept.mean()))


def propose_landmarks(
    vertices: npt.NDArray[Any], faces: npt.NDArray[Any], model: LinearFace
) -> ProposedLandmarks:
    """The places of an aligned template where the fitted model has its landmarks.

    Args:
        vertices: (V, 3) template in the canonical frame, m.
        faces: (F, 3) its triangles.
        model: the face model.

    Raises:
        ValueError: the surfaces are too far apart to be the same face.
    """
    points = np.asarray(vertices, dtype=np.float64)
    fit = fit_face(points, faces, model)
    wanted = fit.vertices[model.landmarks]
    directions = vertex_normals(fit.vertices, model.faces)[model.landmarks]
    places = on_surface(points, faces, wanted, directions)
    return ProposedLandmarks(*places, np.linalg.norm(places[3] - wanted, axis=1), fit)


def on_surface(
    vertices: Points, faces: npt.NDArray[Any], wanted: Points, directions: Points
) -> tuple[npt.NDArray[np.int64], Points, npt.NDArray[np.int64], Points]:
    """The places of a surface nearest to points (N, 3), on its side that faces their directions (N, 3).

    The side is chosen by vertex, so that closed lips and lids do not mix; then the place among the triangles
    around that vertex.

    Args:
        vertices: (V, 3) m.
        faces: (F, 3).
        wanted: (N, 3) m.
        directions: (N, 3) unit normals.

    Returns:
        triangles (N,), barycentric weights (N, 3), the vertex that counts most (N,) and positions (N, 3).
    """
    triangles = np.asarray(faces, dtype=np.int64)
    own = vertex_normals(vertices, triangles)
    used = np.unique(triangles)
    best, shares = np.zeros(len(wanted), np.int64), np.zeros((len(wanted), 3))
    for number, (point, direction) in enumerate(zip(wanted, directions)):
        offset = np.square(vertices[used] - point).sum(axis=1)
        cost = offset + _NORMAL_COST_M**2 * (1 - own[used] @ direction)
        around = np.flatnonzero((triangles == used[cost.argmin()]).any(axis=1))
        weights, away = closest_on_triangles(point, vertices[triangles[around]])
        chosen = int(away.argmin())
        best[number], shares[number] = around[chosen], weights[chosen]
    corners = triangles[best]
    indices = corners[np.arange(len(best)), shares.argmax(axis=1)]
    return best, shares, indices, np.einsum("ncd,nc->nd", vertices[corners], shares)


def _moves(points: Points, modes: Points) -> Points:
    """(N, 3, 7 + K): how points (N, 3) move with rotation, translation, growth and the model's modes (K, N, 3)."""
    moves = np.zeros((len(points), 3, 7 + len(modes)))
    x, y, z = points.T
    moves[:, 0, 1], moves[:, 0, 2] = z, -y  # omega x p
    moves[:, 1, 0], moves[:, 1, 2] = -z, x
    moves[:, 2, 0], moves[:, 2, 1] = y, -x
    moves[:, [0, 1, 2], [3, 4, 5]] = 1.0
    moves[:, :, 6] = points
    moves[:, :, 7:] = modes.transpose(1, 2, 0)
    return moves


def _surface_rows(
    points: Points, offset: Points, normals: Points, modes: Points
) -> tuple[Points, Points]:
    """Rows and values of the least squares that draw samples onto the template's surface."""
    moves = _moves(points, modes)
    along = np.einsum("pdk,pd->pk", moves, normals)
    rows = np.concatenate([along, _SLIDE * moves.reshape(3 * len(points), -1)]) / _NOISE_M
    values = -np.concatenate([(offset * normals).sum(axis=1), _SLIDE * offset.ravel()]) / _NOISE_M
    return rows, values


def _anchor_rows(places: Points, anchors: Anchors, modes: Points) -> tuple[Points, Points]:
    """Rows and values that draw the anchors' places on the model to where they are known to be."""
    weight = np.repeat(1 / anchors.deviation_m, 3)
    rows = weight[:, None] * _moves(places, modes).reshape(3 * len(places), -1)
    return rows, -weight * (places - anchors.positions).ravel()


def _solve(
    surface: tuple[Points, Points], held: tuple[Points, Points] | None, coefficients: Points
) -> Points:
    """Rotation (3), translation (3), growth (1) and change of the coefficients (K) of one round."""
    prior = np.concatenate([np.full(7, 1e-3), np.ones(len(coefficients))])
    normal_matrix, right = np.diag(prior), np.zeros(len(prior))
    right[7:] -= coefficients
    for rows, values in (surface,) if held is None else (surface, held):
        # Neighbouring samples see the same bumps, so all of them together count as a tenth.
        normal_matrix += 0.1 * rows.T @ rows
        right += 0.1 * rows.T @ values
    return np.asarray(np.linalg.solve(normal_matrix, right), dtype=np.float64)


def region_masks(
    vertices: npt.NDArray[Any], landmarks: npt.NDArray[Any], fit: FaceFit
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Lips and upper face by the rules of the open corpus's meshings.

    Lips: frontal projection inside the outer-lip contour (landmarks 48-59) enlarged by 20 % about its
    centre. Upper face: above the line 5 mm under the lower lids, in front of the ears. Both only where the
    fitted face is near, so the inside of the mouth and the back of the head stay out.

    Args:
        vertices: (V, 3) aligned template, m.
        landmarks: (68,) its landmarks.
        fit: the model on it.

    Returns:
        Rising indices of the lips and of the upper face.
    """
    from scipy.spatial import cKDTree

    points = np.asarray(vertices, dtype=np.float64)
    marks = points[landmarks]
    near = cKDTree(fit.vertices).query(points)[0] < _NEAR_M
    contour = marks[48:60, :2]
    contour = contour.mean(axis=0) + 1.2 * (contour - contour.mean(axis=0))
    inside = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(contour, np.roll(contour, -1, axis=0)):
        crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
        slope = (x1 - x0) / (y1 - y0 if y1 != y0 else 1e-12)
        inside ^= crosses & (points[:, 0] < x0 + (points[:, 1] - y0) * slope)
    lips = inside & near & (points[:, 2] > marks[[48, 54], 2].min() - 0.01)
    lower_lids = marks[[40, 41, 46, 47], 1].mean()
    upper = near & (points[:, 1] > lower_lids - 0.005) & (points[:, 2] > marks[0, 2])
    return np.flatnonzero(lips), np.flatnonzero(upper)
