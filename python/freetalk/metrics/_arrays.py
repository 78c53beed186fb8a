"""Arrays of any kind as the tensors that the native room takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    #: A tensor, or what numpy makes an array of.
    Array = torch.Tensor | ArrayLike


def floats(values: Array) -> torch.Tensor:
    """A floating-point tensor; integers become float64."""
    if isinstance(values, np.ndarray) and not values.flags.writeable:
        values = values.copy()  # torch takes no read-only memory
    tensor = torch.as_tensor(values).detach()
    return tensor if tensor.is_floating_point() else tensor.to(torch.float64)


def mask(vertices: Array | None) -> torch.Tensor | None:
    """(V,) bool or (M,) int64."""
    if vertices is None:
        return None
    tensor = torch.as_tensor(vertices)
    return tensor if tensor.dtype == torch.bool else tensor.to(torch.int64)


def flags(valid: Array | None) -> torch.Tensor | None:
    """Bool of the same shape."""
    return None if valid is None else torch.as_tensor(valid).to(torch.bool)


def batched(*tensors: torch.Tensor | None, dims: int) -> tuple[list[Any], bool]:
    """Adds a batch of one where the first tensor lacks it; whether that was so.

    Args:
        tensors: the first decides; ``None`` stays.
        dims: dimensions of the first with its batch.
    """
    first = tensors[0]
    single = first is not None and first.dim() == dims - 1
    if not single:
        return list(tensors), False
    return [None if t is None else t.unsqueeze(0) for t in tensors], True


def text_list(labels: Sequence[str]) -> list[str]:
    """Plain strings, also of numpy's."""
    return [str(label) for label in labels]
