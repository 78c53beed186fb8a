"""From a face that is seen in pictures to points on the surface and the similarity that brings it home."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freetalk.faces.detector import NUM_POINTS, FaceDetector
from freetalk.faces.views import LIGHTS, Camera, Points, Shot, SurfaceViews
from freetalk.geometry import Similarity

#: The outline of MediaPipe's face: where a face ends in a picture, not always the same place on the surface.
OUTLINE = np.array(
    [10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150,
     136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109]
)  # fmt: skip
#: Half a picture's side around a face, m, and how far its middle is above the mean landmark.
_HALF_M, _RISE_M = 0.145, 0.005
#: Looks (yaw, pitch, degrees; light) whose points are joined.
_LOOKS = (
    *((0.0, 0.0, 0), (0.0, 0.0, 1), (0.0, 0.0, 2), (-28.0, 0.0, 0), (28.0, 0.0, 0)),
    *((-14.0, 8.0, 1), (14.0, 8.0, 2), (0.0, -12.0, 0), (0.0, 14.0, 0)),
)
#: Pixels around a point in which the surface it lies on is looked for.
_WINDOW = 5


@dataclass(frozen=True)
class Sighting:
    """A face, seen.

    Attributes:
        points: (468, 3) MediaPipe's points on the surface, the mesh's own unit and axes.
        weights: (468,) in [0, 1], 0 where a point was not seen.
        spread: (468,) deviation between the pictures, in distances between the eyes.
        pose: to the canonical frame.
        misfit: mean distance from the mean face's points in that frame, in distances between the eyes.
        score: share of the looks in which a face was seen, weighed by the detector's score.
    """

    points: Points
    weights: Points
    spread: Points
    pose: Similarity
    misfit: float
    score: float


def fit_pose(points: Points, reference: Points, weights: Points, rounds: int = 12) -> Similarity:
    """The similarity that brings points (N, 3) to reference points (N, 3), robust (Umeyama 1991, reweighted)."""
    sure = np.asarray(weights, dtype=np.float64)
    pose = Similarity()
    robust = np.ones(len(points))
    for _ in range(rounds):
        share = np.asarray(sure * robust)[:, None]
        share = share / share.sum()
        center, goal = (share * points).sum(axis=0), (share * reference).sum(axis=0)
        a, b = points - center, reference - goal
        u, s, vt = np.linalg.svd((share * b).T @ a)
        flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        rotation = (u * flip) @ vt
        scale = float((s * flip).sum() / max(float((share * a * a).sum()), 1e-30))
        pose = Similarity(scale, rotation, translation=goal - scale * rotation @ center)
        distance = np.linalg.norm(pose.apply(points) - reference, axis=1)
        typical = float(np.median(distance[sure > 0])) + 1e-12
        robust = 1.0 / (1.0 + (distance / (2.0 * typical)) ** 2)
    return pose


def camera_of(pose: Similarity, yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Camera:
    """The camera before a face, turned about it."""
    yaw, pitch = np.deg2rad(yaw_deg), np.deg2rad(pitch_deg)
    toward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    axes = np.stack([right, np.cross(toward, right), toward]) @ pose.rotation
    return Camera(
        pose.inverse().apply(np.array([[0.0, _RISE_M, 0.0]]))[0], axes, _HALF_M / pose.scale
    )


def lift(shot: Shot, seen: Points) -> tuple[Points, Points]:
    """Casts the points of a picture back onto the surface.

    Where a point falls into an opening or past the edge of the face, the surface next to it counts that lies at
    the depth which the face's other points let expect.

    Args:
        shot: the picture.
        seen: (N, 3) of :meth:`FaceDetector.points`.

    Returns:
        (N, 3) in the mesh's unit and axes, and weights (N,): 1 where the surface faces the camera, 0 where there is
        none.
    """
    side, half = len(shot.nearness), shot.camera.half
    pixel = np.clip(np.floor(seen[:, :2] * side).astype(int), 0, side - 1)
    offsets = np.mgrid[-_WINDOW : _WINDOW + 1, -_WINDOW : _WINDOW + 1].reshape(2, -1).T
    rows = np.clip(pixel[:, 1, None] + offsets[:, 0], 0, side - 1)
    columns = np.clip(pixel[:, 0, None] + offsets[:, 1], 0, side - 1)
    near = shot.nearness[rows, columns]  # (N, W)
    relief = -2 * half * seen[:, 2]
    middle = near[:, len(offsets) // 2]
    expected = relief + np.nanmedian(middle - relief) if np.isfinite(middle).any() else relief
    width = 2 * half * float(np.ptp(seen[:, 0]))
    aside = (offsets**2).sum(axis=1) / _WINDOW**2
    cost = aside + ((near - expected[:, None]) / (0.12 * width)) ** 2
    cost[np.isnan(cost)] = np.inf
    best = cost.argmin(axis=1)
    index = np.arange(len(seen))
    found = np.isfinite(cost[index, best])
    # The fraction of a pixel is kept: the surface is taken to rise evenly within it.
    chosen = rows[index, best], columns[index, best]
    rise = np.stack([np.gradient(shot.nearness, axis=axis)[chosen] for axis in (1, 0)], axis=-1)
    rise = np.nan_to_num(rise, nan=0.0)
    fraction = np.clip(seen[:, :2] * side - pixel - 0.5, -0.5, 0.5)
    depth = np.where(found, near[index, best], expected) + (rise * fraction).sum(axis=1)
    shifted = seen[:, :2] + offsets[best][:, ::-1] / side
    local = np.column_stack([2 * shifted[:, 0] - 1, 1 - 2 * shifted[:, 1], depth])
    slope = np.linalg.norm(rise, axis=1) * side / (2 * half)
    weights = np.where(found, np.exp(-cost[index, best]) / (1 + slope**2), 0.0)
    return shot.camera.unproject(local), weights


def look(
    views: SurfaceViews, detector: FaceDetector, camera: Camera, light: int = 0
) -> tuple[Points, Points] | None:
    """The points that a face in one picture has on the surface, with weights; None where none is seen."""
    shot = views.shoot(camera, light)
    seen = detector.points(shot.image)
    if seen is None:
        return None
    points, weights = lift(shot, seen)
    return (points, weights) if (weights > 0.05).sum() >= NUM_POINTS // 4 else None


def approach(
    views: SurfaceViews, detector: FaceDetector, camera: Camera, reference: Points
) -> Similarity | None:
    """Steps before a face that a camera sees somehow; None where it is none on a closer look."""
    inner = np.ones(NUM_POINTS)
    inner[OUTLINE] = 0.2
    pose = None
    for _ in range(4):
        found = look(views, detector, camera)
        if found is None:
            return None
        before = pose
        pose = fit_pose(found[0], reference, found[1] * inner)
        camera = camera_of(pose)
        if before is not None:
            turn = np.arccos(np.clip((np.trace(before.rotation.T @ pose.rotation) - 1) / 2, -1, 1))
            if turn < np.deg2rad(2) and abs(np.log(pose.scale / before.scale)) < 0.03:
                break
    return pose


def observe(
    views: SurfaceViews, detector: FaceDetector, pose: Similarity, reference: Points, eyes_m: float
) -> Sighting | None:
    """Looks at a face from several sides in several lights and joins what is seen.

    Args:
        views: the surface.
        detector: what finds the points.
        pose: where the face is, roughly.
        reference: (468, 3) the mean face's points, canonical frame, m.
        eyes_m: distance between the mean face's eyes, m.

    Returns:
        The face; None where fewer than a third of the looks show one.
    """
    seen: list[tuple[Points, Points]] = []
    score = 0.0
    for yaw, pitch, light in _LOOKS:
        found = look(views, detector, camera_of(pose, yaw, pitch), light % len(LIGHTS))
        if found is None:
            continue
        seen.append(found)
        score += 1 / len(_LOOKS)
    if 3 * len(seen) < len(_LOOKS):
        return None
    stack = np.stack([points for points, _ in seen])  # (L, N, 3)
    weights = np.stack([share for _, share in seen]) + 1e-9
    points = _robust_mean(stack, weights)
    unit = eyes_m / pose.scale
    off = np.linalg.norm(stack - points, axis=2)
    spread = np.sqrt((weights * off**2).sum(axis=0) / weights.sum(axis=0)) / unit
    points = views.nearest(points)[0]
    sure = np.clip(weights.sum(axis=0) / max(1.0, 0.35 * len(seen)), 0.0, 1.0)
    inner = sure.copy()
    inner[OUTLINE] *= 0.2
    final = fit_pose(points, reference, inner)
    distance = np.linalg.norm(final.apply(points) - reference, axis=1) / eyes_m
    misfit = float((inner * distance).sum() / inner.sum())
    return Sighting(points, sure, spread, final, misfit, score)


def _robust_mean(stack: Points, weights: Points) -> Points:
    """(N, 3) weighted means of (L, N, 3) in which what lies apart counts less."""
    share = weights
    for _ in range(4):
        mean = (share[..., None] * stack).sum(axis=0) / share.sum(axis=0)[:, None]
        off = np.linalg.norm(stack - mean, axis=2)
        typical = np.median(off, axis=0) + 1e-12
        share = weights / np.maximum(1.0, off / typical)
    return np.asarray((share[..., None] * stack).sum(axis=0) / share.sum(axis=0)[:, None])
