"""Faces in pictures: MediaPipe's detector and face mesh, which come with its wheel (Apache-2.0).

An optional extra, ``pip install 'freetalk[faces]'``; nothing else of the package imports it.
"""

from __future__ import annotations

import logging
import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

#: Points of MediaPipe's face mesh; the ten of the irises behind them are not used.
NUM_POINTS = 468
INSTALL = "pip install 'freetalk[faces]'"


@dataclass(frozen=True)
class Detection:
    """A face in a picture.

    Attributes:
        score: the detector's, in [0, 1].
        box: (4,) left, top, width, height, as shares of the picture's sides.
        eyes: (2, 2) the two eyes (right of the subject, left), likewise.
    """

    score: float
    box: NDArray[np.float64]
    eyes: NDArray[np.float64]

    @property
    def roll(self) -> float:
        """Radians by which the line between the eyes is turned in the picture, clockwise."""
        across = self.eyes[1] - self.eyes[0]
        return float(np.arctan2(across[1], across[0]))


def available() -> bool:
    """Whether the extra ``faces`` is installed."""
    return find_spec("mediapipe") is not None


@lru_cache(maxsize=1)
def detector() -> FaceDetector:
    """The one detector of this process.

    Raises:
        RuntimeError: the extra is not installed, or MediaPipe cannot start.
    """
    return FaceDetector()


class FaceDetector:
    """MediaPipe's networks; calls from several threads wait for one another.

    Raises:
        RuntimeError: the extra is not installed, or MediaPipe cannot start.
    """

    def __init__(self) -> None:
        if not available():
            raise RuntimeError(f"faces are looked for with MediaPipe, which is missing: {INSTALL}")
        os.environ.setdefault("GLOG_minloglevel", "2")
        with _quiet(), _own_warnings():
            try:
                from mediapipe.python.solutions import face_detection, face_mesh
            except ImportError as error:
                raise RuntimeError(
                    f"MediaPipe cannot be used ({error}); its release 0.10.14 carries the "
                    f"models that are needed: {INSTALL}"
                ) from error
            self._far = face_detection.FaceDetection(
                model_selection=1, min_detection_confidence=0.3
            )
            self._near = face_detection.FaceDetection(
                model_selection=0, min_detection_confidence=0.3
            )
            self._mesh = face_mesh.FaceMesh(
                static_image_mode=True, max_num_faces=1, min_detection_confidence=0.3
            )
            blank = np.zeros((64, 64, 3), dtype=np.uint8)
            for network in (self._far, self._near, self._mesh):
                network.process(blank)
        self._lock = threading.Lock()

    def detect(self, image: Image, far: bool = False) -> list[Detection]:
        """Faces of a picture, best first.

        Args:
            image: (H, W, 3) uint8.
            far: for faces that fill little of the picture.
        """
        with self._lock, _own_warnings():
            found = (self._far if far else self._near).process(image).detections
        detections = []
        for each in found or []:
            where = each.location_data
            box = where.relative_bounding_box
            points = where.relative_keypoints
            detections.append(
                Detection(
                    float(each.score[0]),
                    np.array([box.xmin, box.ymin, box.width, box.height]),
                    np.array([[points[k].x, points[k].y] for k in (0, 1)]),
                )
            )
        return sorted(detections, key=lambda detection: -detection.score)

    def points(self, image: Image) -> NDArray[np.float64] | None:
        """The points of the one face of a picture, upright and filling a third of it or more.

        Args:
            image: (H, W, 3) uint8.

        Returns:
            (468, 3) right and down in [0, 1] over the picture, and depth away from the camera in the same
            measure as right; None where no face is seen.
        """
        with self._lock, _own_warnings():
            found: Any = self._mesh.process(image).multi_face_landmarks
        if not found:
            return None
        points = [(point.x, point.y, point.z) for point in found[0].landmark[:NUM_POINTS]]
        return np.array(points, dtype=np.float64)


@contextmanager
def _own_warnings() -> Iterator[None]:
    """Keeps MediaPipe's words about its own use of protobuf off the terminal."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="SymbolDatabase", category=UserWarning)
        yield


@contextmanager
def _quiet() -> Iterator[None]:
    """Keeps what MediaPipe's libraries write to the terminal while they start off it."""
    saved = os.dup(2)
    logging_level = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with open(os.devnull, "wb") as nowhere:  # noqa: PTH123
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        logging.disable(logging_level)
