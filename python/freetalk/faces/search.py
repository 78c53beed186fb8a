"""Looks for a face on a surface of any unit and pose: from all sides, upright and not, near and far."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from freetalk.faces.detector import Detection, FaceDetector
from freetalk.faces.points import eye_distance, load_face_points
from freetalk.faces.sighting import Sighting, approach, camera_of, observe
from freetalk.faces.views import Camera, Points, Shot, SurfaceViews, facing
from freetalk.geometry import Similarity
from freetalk.viz.occlusion import sphere_directions

#: What looks like a face: share of the looks that show one, and mean distance from the mean face's points in
#: distances between the eyes. Human heads: 1 and 0.03 to 0.06.
MIN_SCORE, MAX_MISFIT = 0.5, 0.14
#: At these the search ends; what is found meanwhile is compared.
_SURE_SCORE, _SURE_MISFIT = 0.85, 0.09
_FEWEST_SCORE = 0.45
_AXES = np.array(
    [[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, -1, 0], [0, 1, 0]], dtype=np.float64
)
_ALL_AROUND = 42
#: A picture of the whole, then parts of it for faces that are small on it.
_CLOSER = 3


def search(
    views: SurfaceViews, detector: FaceDetector, landmarks: Points, hint: Similarity | None = None
) -> Sighting | None:
    """The most face-like part of a surface.

    Args:
        views: the surface.
        detector: what finds faces.
        landmarks: (68, 3) of the mean face, canonical frame, m.
        hint: where the face may be; looked at first.

    Returns:
        The face; None where nothing looks like one.
    """
    reference, eyes = load_face_points().mean, eye_distance(landmarks)
    best: Sighting | None = None
    tried: list[Similarity] = []
    for camera in _candidates(views, detector, hint):
        pose = approach(views, detector, camera, reference)
        if pose is None or any(_same(pose, other) for other in tried):
            continue
        tried.append(pose)
        found = observe(views, detector, pose, reference, eyes)
        if found is None or found.score < MIN_SCORE or found.misfit > MAX_MISFIT:
            continue
        if best is None or _rank(found) > _rank(best):
            best = found
        if found.score >= _SURE_SCORE and found.misfit <= _SURE_MISFIT:
            break
    return best


def _candidates(
    views: SurfaceViews, detector: FaceDetector, hint: Similarity | None
) -> Iterator[Camera]:
    """Cameras before what the detector takes for faces, the likely ones first."""
    if hint is not None:
        yield camera_of(hint)
    points = views.surface_points()
    own = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    # A face that is small on a body looks along an axis of the file or of the body, or between two of them.
    between = (own[[0, 0, 1]] + own[[1, 2, 2]]) / 2**0.5
    closer_sides = np.concatenate([_AXES, own[::-1], -own[::-1], between, -between])
    around = np.concatenate([_AXES, sphere_directions(_ALL_AROUND)])
    middle = (views.low + views.high) / 2
    half = 0.5 * float(np.linalg.norm(views.high - views.low))
    doubtful: list[tuple[float, Camera]] = []
    for closer, sides in ((1, around), (_CLOSER, closer_sides)):
        for toward in sides:
            whole = Camera(middle, facing(toward), half)
            found: list[tuple[float, Camera]] = []
            for camera in _tiles(views, whole, closer):
                found += _faces(views.shoot(camera), detector, near=closer == 1)
            found.sort(key=lambda each: -each[0])
            for score, camera in found[:2]:
                if score >= 0.7:
                    yield camera
                else:
                    doubtful.append((score, camera))
        doubtful.sort(key=lambda each: -each[0])
        for _, camera in doubtful[:12]:
            yield camera
        doubtful.clear()


def _tiles(views: SurfaceViews, whole: Camera, closer: int) -> Iterator[Camera]:
    """Overlapping parts of a picture in which there is surface, seen ``closer`` times nearer."""
    if closer == 1:
        yield whole
        return
    count = 2 * closer - 1
    centers = np.linspace(-1 + 1 / closer, 1 - 1 / closer, count)
    seen = whole.project(views.surface_points())[:, :2]
    right, up, _ = whole.rotation
    for x in centers:
        for y in centers:
            if (np.abs(seen - [x, y]).max(axis=1) < 0.6 / closer).mean() < 2e-3:
                continue
            target = whole.target + whole.half * (x * right + y * up)
            yield Camera(target, whole.rotation, whole.half / closer)


def _faces(shot: Shot, detector: FaceDetector, near: bool) -> list[tuple[float, Camera]]:
    """The detector's scores, and cameras upright before each face of a picture in its four quarter turns."""
    found = []
    for quarter in range(4):
        image = np.ascontiguousarray(np.rot90(shot.image, quarter))
        seen = [
            each
            for far in ((True, False) if near else (True,))
            for each in detector.detect(image, far)
        ]
        if not seen:
            continue
        best = max(seen, key=lambda each: each.score)
        if best.score >= _FEWEST_SCORE:
            camera = _before(shot, quarter, best)
            if camera is not None:
                found.append((best.score, camera))
    return found


def _before(shot: Shot, quarter: int, face: Detection) -> Camera | None:
    """The camera upright before a detected face."""
    camera = shot.camera.turned(quarter)
    left, top, width, height = face.box
    x, y = left + width / 2, top + height / 2
    nearness = np.rot90(shot.nearness, quarter)
    side = len(nearness)
    rows = slice(*np.clip([int(side * top), int(side * (top + height)) + 1], 0, side))
    columns = slice(*np.clip([int(side * left), int(side * (left + width)) + 1], 0, side))
    depths = nearness[rows, columns]
    if not np.isfinite(depths).any():
        return None
    local = np.array([[2 * x - 1, 1 - 2 * y, float(np.nanmedian(depths))]])
    angle = face.roll  # clockwise in the picture
    right, up, toward = camera.rotation
    axes = np.stack(
        [
            np.cos(angle) * right - np.sin(angle) * up,
            np.sin(angle) * right + np.cos(angle) * up,
            toward,
        ]
    )
    return Camera(camera.unproject(local)[0], axes, 1.7 * camera.half * float(max(width, height)))


def _rank(found: Sighting) -> float:
    return found.score - 3 * found.misfit


def _same(a: Similarity, b: Similarity) -> bool:
    """Whether two poses show one face: a tenth in size, 20 degrees, 3 cm."""
    turn = (np.trace(a.rotation.T @ b.rotation) - 1) / 2
    origin = a.apply(b.inverse().apply(np.zeros((1, 3))))[0]
    return bool(
        abs(np.log(a.scale / b.scale)) < 0.1
        and turn > np.cos(np.deg2rad(20))
        and np.linalg.norm(origin) < 0.03
    )
