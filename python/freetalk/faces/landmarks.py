"""The 68 landmarks of a face that was seen: the built-in face fitted to points and surface, then what it misses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.corpus.linear_face import built_in_face
from freetalk.data.landmark_transfer import (
    Anchors,
    FaceFit,
    fit_face,
    on_surface,
    propose_landmarks,
)
from freetalk.faces.points import eye_distance, load_face_points
from freetalk.faces.sighting import Sighting, fit_pose
from freetalk.geometry import Similarity
from freetalk.mesh import vertex_normals

Points = NDArray[np.float64]

#: Landmarks that a person marks, and how they are called; right and left are the face's own.
MARKS = (
    (36, "the outer corner of the face's right eye"),
    (39, "the inner corner of the same eye"),
    (42, "the inner corner of its left eye"),
    (45, "the outer corner of the left eye"),
    (30, "the tip of the nose"),
    (48, "the right corner of the mouth"),
    (54, "the left corner of the mouth"),
    (8, "the lowest point of the chin, in the middle"),
)
#: Marks are about as certain (m), and this far (of their size) from those of a mean face at most.
_MARKED_M, _MARKS_OFF = 0.002, 0.35
#: Surface farther than this (m) from the middle of the face is not part of it.
_FACE_RADIUS_M = 0.16
#: A landmark as far as this (m) from the built-in face fitted to the surface is doubtful.
_DOUBTFUL_M = 0.005
#: Within this (m) of the middle of the face, most of its surface looks forward.
_FRONT_RADIUS_M = 0.06
#: Of MediaPipe's points, those around a landmark that tell what the fitted face misses there.
_NEIGHBOURS = 6
#: Points count as less certain than they are (by this factor) beside a surface that a human face fits, and move a
#: landmark off the fitted face only where they miss it by more than this many deviations.
_CALM, _CLEAR = 2.0, 2.0


@dataclass(frozen=True)
class FoundLandmarks:
    """68 points on a mesh.

    Attributes:
        triangles: (68,) the triangle each lies on.
        weights: (68, 3) barycentric on it, sum 1.
        indices: (68,) the vertex that counts most.
        positions: (68, 3) in the mesh's own unit and axes.
        confidence: (68,) in [0, 1]: 1 where pictures and surface agree, 0 where neither shows the place.
        fit: the built-in face on the mesh, in the frame of ``pose``, m; None where it does not fit.
        pose: from the mesh to the canonical frame.
        summary: how they were found.
    """

    triangles: NDArray[np.int64]
    weights: Points
    indices: NDArray[np.int64]
    positions: Points
    confidence: Points
    fit: FaceFit | None
    pose: Similarity
    summary: str


def seen_landmarks(
    vertices: NDArray[Any], faces: NDArray[Any], sighting: Sighting
) -> FoundLandmarks:
    """The landmarks of a face that was seen.

    The built-in face's identity follows MediaPipe's points and the surface; what it misses at the points around
    a landmark moves the landmark, so that faces that are not human keep their own proportions.

    Args:
        vertices: (V, 3) any unit.
        faces: (F, 3).
        sighting: where the face was seen.
    """
    points, model = load_face_points(), built_in_face()
    pose = sighting.pose
    home = pose.apply(vertices)
    outward, order = _outward(home, faces)
    targets = pose.apply(sighting.points)
    eyes_m = eye_distance(model.neutral[model.landmarks])
    doubt = np.hypot(points.deviation, sighting.spread / 3) * eyes_m
    sure = sighting.weights > 0.1
    anchors = Anchors(
        points.vertices[sure],
        points.weights[sure],
        targets[sure],
        _CALM * doubt[sure] / np.sqrt(sighting.weights[sure]),
    )
    near = np.linalg.norm(home[faces].mean(axis=1), axis=1) < _FACE_RADIUS_M
    fit: FaceFit | None = None
    if near.any():
        try:
            fit = fit_face(home, outward[near], model, anchors)
        except ValueError:
            fit = None
    fitted = np.asarray(model.neutral, dtype=np.float64) if fit is None else fit.vertices
    missed = targets - points.of(fitted)
    wanted = fitted[model.landmarks]
    reach = np.linalg.norm(wanted[:, None] - points.of(fitted)[None], axis=2)
    reach[:, ~sure] = np.inf
    nearest = np.argsort(reach, axis=1)[:, :_NEIGHBOURS]
    share = 1 / (np.take_along_axis(reach, nearest, axis=1) + 0.1 * eyes_m) ** 2
    share *= (1 / doubt**2)[nearest]
    share /= share.sum(axis=1, keepdims=True)
    correction = np.einsum("kn,knd->kd", share, missed[nearest])
    noise = np.sqrt((share * doubt[nearest] ** 2).sum(axis=1))
    size = np.linalg.norm(correction, axis=1)
    clear = np.maximum(0.0, 1 - (_CLEAR * noise / np.maximum(size, 1e-9)) ** 2)
    wanted = wanted + clear[:, None] * correction
    directions = vertex_normals(fitted, model.faces)[model.landmarks]
    triangles, weights, indices, places = on_surface(home, outward, wanted, directions)
    off = np.linalg.norm(places - wanted, axis=1) / eyes_m
    seen = (share * sighting.weights[nearest]).sum(axis=1)
    confidence = seen * np.exp(-((off / 0.05) ** 2) - (size / eyes_m / 0.15) ** 2)
    summary = f"face seen in {sighting.score:.0%} of the pictures"
    if fit is not None:
        summary += f", the built-in face fits to {1000 * fit.residual_m:.1f} mm"
    places = pose.inverse().apply(places)
    corners = weights[:, order]
    return FoundLandmarks(triangles, corners, indices, places, confidence, fit, pose, summary)


def geometric_landmarks(
    vertices: NDArray[Any], faces: NDArray[Any], pose: Similarity
) -> FoundLandmarks:
    """The landmarks of a face that was not looked at: the built-in face fitted to the surface alone.

    Args:
        vertices: (V, 3) any unit.
        faces: (F, 3).
        pose: to the canonical frame.

    Raises:
        ValueError: the surface and the built-in face hardly meet.
    """
    home = pose.apply(vertices)
    outward, order = _outward(home, faces)
    found = propose_landmarks(home, outward, built_in_face())
    confidence = np.exp(-((found.distance_m / _DOUBTFUL_M) ** 2))
    places = (
        found.triangles,
        found.weights[:, order],
        found.indices,
        pose.inverse().apply(found.positions),
    )
    summary = (
        f"the built-in face fits to {1000 * found.fit.residual_m:.1f} mm "
        f"over {100 * found.fit.paired:.0f} % of it"
    )
    return FoundLandmarks(*places, confidence, found.fit, pose, summary)


def marked_landmarks(vertices: NDArray[Any], faces: NDArray[Any], marks: NDArray[Any]) -> Points:
    """The landmarks of a face on which a person marked some: :data:`MARKS`.

    The built-in face is fitted to the surface with its landmarks at the marks; what it misses there moves those
    around them, so that faces that are not human keep their own proportions.

    Args:
        vertices: (V, 3) any unit and pose.
        faces: (F, 3).
        marks: (M, 3) the places of ``MARKS``, in their order.

    Returns:
        (68, 3) on the surface, in the mesh's own unit and axes.

    Raises:
        ValueError: other than M points, or they do not lie as those of a face do.
    """
    model, indices = built_in_face(), [index for index, _ in MARKS]
    given = np.asarray(marks, dtype=np.float64)
    if given.shape != (len(MARKS), 3) or not np.isfinite(given).all():
        raise ValueError(f"marks must be ({len(MARKS)}, 3) numbers, found {given.shape}")
    usual = np.asarray(model.neutral, np.float64)[model.landmarks]
    pose = fit_pose(given, usual[indices], np.ones(len(given)))
    targets = pose.apply(given)
    off = np.linalg.norm(targets - usual[indices], axis=1).mean()
    size = np.linalg.norm(usual[indices] - usual[indices].mean(axis=0), axis=1).mean()
    nose = targets[indices.index(30), 2] - targets[:, 2].mean()
    if nose < 0 or not off < _MARKS_OFF * size:  # mirrored, most marks fit a face seen from within
        raise ValueError(
            "the marks do not lie as those of a face do: its right eye is on your left when it looks at you"
        )
    home = pose.apply(vertices)
    outward, _ = _outward(home, faces)
    corners = np.repeat(np.asarray(model.landmarks)[indices][:, None], 3, axis=1)
    anchors = Anchors(
        corners, np.tile([1.0, 0.0, 0.0], (len(given), 1)), targets, np.full(len(given), _MARKED_M)
    )
    near = np.linalg.norm(home[outward].mean(axis=1), axis=1) < _FACE_RADIUS_M
    try:
        fitted = fit_face(home, outward[near], model, anchors).vertices
    except ValueError:
        fitted = np.asarray(model.neutral, dtype=np.float64)
    wanted = fitted[model.landmarks]
    reach = np.linalg.norm(wanted[:, None] - wanted[indices][None], axis=2)
    share = 1 / (reach + _MARKED_M) ** 2
    wanted = wanted + share @ (targets - wanted[indices]) / share.sum(axis=1, keepdims=True)
    directions = vertex_normals(fitted, model.faces)[model.landmarks]
    return np.asarray(pose.inverse().apply(on_surface(home, outward, wanted, directions)[3]))


def _outward(home: Points, faces: NDArray[Any]) -> tuple[NDArray[np.int64], list[int]]:
    """(F, 3) the triangles, turned around if the front of the face is wound inside out, and the order of the
    corners that undoes it."""
    triangles = np.asarray(faces, dtype=np.int64)
    corners = home[triangles]
    front = np.linalg.norm(corners.mean(axis=1), axis=1) < _FRONT_RADIUS_M
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    order = [2, 1, 0] if areas[front, 2].sum() < 0 else [0, 1, 2]
    return triangles[:, order], order


def home_pose(positions: Points, confidence: Points) -> Similarity:
    """The similarity that brings landmarks (68, 3) to the mean face's."""
    model = built_in_face()
    return fit_pose(
        positions, np.asarray(model.neutral, np.float64)[model.landmarks], 0.1 + confidence
    )
