"""Motion at another frame rate."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

#: Frame numbers this close below a whole one count as it: they come from divisions.
_TOLERANCE = 1e-6


def interpolate_frames(values: FloatArray, frames: npt.NDArray[np.floating]) -> FloatArray:
    """Rows of `values` (T, ...) at real-valued frame numbers (N,), linearly; the ends are held.

    Returns:
        (N, ...) of the dtype of `values`.
    """
    low = np.clip(np.floor(frames + _TOLERANCE).astype(np.int64), 0, len(values) - 1)
    share = (frames - low).clip(0.0).astype(np.float32)
    if not share.any():
        return np.ascontiguousarray(values[low])
    high = np.minimum(low + 1, len(values) - 1)
    share = share.reshape((-1,) + (1,) * (values.ndim - 1))
    result: FloatArray = values[low] * (1 - share) + values[high] * share
    return result
