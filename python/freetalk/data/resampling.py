"""Motion at another frame rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import numpy.typing as npt
from scipy.signal import resample_poly

FloatArray = npt.NDArray[np.float32]

#: Frame numbers this close below a whole one count as it: they come from divisions.
_TOLERANCE = 1e-6
#: Frame rates as fractions of whole numbers: 29.97 is 2997 / 100.
_RATE_DENOMINATOR = 1001


def frames_at(num_frames: int, fps: float, rate: float) -> int:
    """Frames at `rate` whose times lie within `num_frames` at `fps`."""
    return int((num_frames - 1) * rate / fps + _TOLERANCE) + 1


def resample_frames(values: FloatArray, fps: float, rate: float) -> FloatArray:
    """Motion (T, ...) at `fps` as it is at `rate`, frame 0 at the same time.

    Band-limited by a polyphase filter, so that nothing faster than the lower rate can show comes back as a
    slow motion, and nothing below it is lost, as between straight lines. The ends go on along the line
    from the first to the last frame.

    Returns:
        (``frames_at(T, fps, rate)``, ...) of the dtype of `values`.
    """
    ratio = Fraction(rate).limit_denominator(_RATE_DENOMINATOR) / Fraction(fps).limit_denominator(
        _RATE_DENOMINATOR
    )
    wanted = resample_poly(values, ratio.numerator, ratio.denominator, axis=0, padtype="line")
    return wanted[: frames_at(len(values), fps, rate)].astype(values.dtype)


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
    return values[low] * (1 - share) + values[high] * share
