"""Arrays and tensors of a caller, as the native rooms take them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def as_array(values: ArrayLike | torch.Tensor, dtype: type) -> NDArray:
    """A NumPy array of ``dtype`` on the CPU, no copy where it is one already.

    Raises:
        ValueError: int32 (indices of faces) is asked of values that are not integers.
    """
    if isinstance(values, torch.Tensor):
        values = values.detach().cpu().numpy()
    array = np.asarray(values)
    if dtype is np.int32 and array.size > 0 and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"faces must be integers, found {array.dtype}")
    return np.asarray(array, dtype=dtype)
