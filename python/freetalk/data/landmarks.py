"""The 68 landmarks (iBUG order): which are where, and what is measured on them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from freetalk import _native

FloatArray = npt.NDArray[np.float32]

NUM_LANDMARKS: int = _native.core.NUM_LANDMARKS

LIPS: tuple[int, ...] = tuple(range(48, NUM_LANDMARKS))
BROWS: tuple[int, ...] = tuple(range(17, 27))
EYES: tuple[int, ...] = tuple(range(36, 48))
UPPER_FACE: tuple[int, ...] = (*BROWS, *EYES)
UPPER_INNER_LIP = 62
LOWER_INNER_LIP = 66
#: Upper and lower inner-lip landmarks that face one another.
INNER_LIP_PAIRS: tuple[tuple[int, ...], tuple[int, ...]] = ((61, 62, 63), (67, 66, 65))


def lip_opening(landmarks: FloatArray) -> FloatArray:
    """Change of the vertical inner-lip gap against neutral.

    Args:
        landmarks: (..., 68, 3) displacements, m, +Y up.

    Returns:
        (...) m, 0 where the lips are as in the neutral face.
    """
    return landmarks[..., UPPER_INNER_LIP, 1] - landmarks[..., LOWER_INNER_LIP, 1]
