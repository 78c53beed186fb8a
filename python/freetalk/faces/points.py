"""Where MediaPipe's points lie on the built-in face, and how surely they are found there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.corpus.assets import load_face_model
from freetalk.data.triangles import Places

Points = NDArray[np.float64]

#: Outer corners of the eyes among the 68 landmarks: their distance is the measure of errors.
EYE_CORNERS = (36, 45)
FILE = Path(__file__).with_name("points.npz")


@dataclass(frozen=True)
class FacePoints(Places):
    """MediaPipe's 468 points as places on the ICT face.

    Attributes:
        deviation: (468,) how far from there they are found, in distances between the eyes (root mean square
            over rendered identities).
    """

    deviation: Points

    @property
    def mean(self) -> Points:
        """(468, 3) on the mean face, canonical frame, m."""
        return self.of(load_face_model().neutral)


@lru_cache(maxsize=1)
def load_face_points() -> FacePoints:
    """Reads what ``scripts/pack_face_points.py`` measured."""
    with np.load(FILE) as data:
        return FacePoints(
            data["vertices"].astype(np.int64),
            data["weights"].astype(np.float64),
            data["deviation"].astype(np.float64),
        )


def eye_distance(landmarks: NDArray[Any]) -> float:
    """Distance between the outer corners of the eyes of landmarks (68, 3)."""
    marks = np.asarray(landmarks, dtype=np.float64)
    return float(np.linalg.norm(marks[EYE_CORNERS[0]] - marks[EYE_CORNERS[1]]))
