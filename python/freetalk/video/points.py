"""Which points of MediaPipe's face mesh are the 68 landmarks, and how far each is trusted."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: MediaPipe FaceMesh index of each of the 68 landmarks (iBUG order).
LANDMARK_POINTS: tuple[int, ...] = (
    127, 234, 93, 58, 172, 136, 149, 148, 152, 377, 378, 365, 397, 288, 323, 454, 356,
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,
    168, 197, 5, 4, 98, 97, 2, 326, 327,
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,
    78, 82, 13, 312, 308, 317, 14, 87,
)  # fmt: skip
NUM_MESH_POINTS = 478

#: Landmarks whose distance is fitted beside their places: lips, corners of the mouth, lids.
PAIRS: tuple[tuple[int, int], ...] = (
    (61, 67), (62, 66), (63, 65), (51, 57), (48, 54), (60, 64), (37, 41), (38, 40), (43, 47), (44, 46),
)  # fmt: skip

_JAW, _BROWS, _LIPS, _CHIN = slice(0, 17), slice(17, 27), slice(48, 68), slice(6, 11)


def point_weights() -> npt.NDArray[np.float64]:
    """(68,) trust in each landmark: lips most, the outline, which slides along the cheek, least."""
    weights = np.ones(len(LANDMARK_POINTS))
    weights[_JAW], weights[_CHIN], weights[_BROWS], weights[_LIPS] = 0.1, 0.5, 0.6, 2.0
    return weights


def rigid_weights() -> npt.NDArray[np.float64]:
    """(68,) trust in each landmark for the head's pose: what speech moves does not count."""
    weights = np.zeros(len(LANDMARK_POINTS))
    weights[:3] = weights[14:17] = 0.2  # beside the ears
    weights[_BROWS], weights[27:36] = 0.2, 1.0
    weights[[36, 39, 42, 45]] = 1.5  # corners of the eyes
    return weights
