"""The optimiser's view of the weights: which of them decay, and their moving average."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

#: Parts of the names of tables: learned positions, embeddings of labels, codes of landmarks.
_TABLES = ("positions", "embedding", "index_code", "diffusion_time")
#: The gain of a weight-normed convolution, in both of torch's spellings.
_GAINS = ("weight.original0", "weight_g")


def moving_average(model: nn.Module, decay: float) -> AveragedModel:
    """A copy that follows a model's weights; the decay rises from 0 so that early steps are forgotten.

    Args:
        model: whose weights.
        decay: of the exponential moving average, reached after many steps.
    """

    def move(average: Sequence[Tensor], own: Sequence[Tensor], count: Tensor | int) -> None:
        rising = (2 + int(count)) / (11 + int(count))
        get_ema_multi_avg_fn(min(decay, rising))(list(average), list(own), count)

    return AveragedModel(model, multi_avg_fn=move)


def parameter_groups(model: nn.Module, weight_decay: float) -> list[dict[str, Any]]:
    """Decay for matrices and kernels; none for biases, norms, gains, diffusion times and tables."""
    decayed = [p for name, p in model.named_parameters() if decays(name, p)]
    spared = [p for name, p in model.named_parameters() if not decays(name, p)]
    groups = [
        {"params": decayed, "weight_decay": weight_decay},
        {"params": spared, "weight_decay": 0.0},
    ]
    return [group for group in groups if group["params"]]


def decays(name: str, parameter: Tensor) -> bool:
    """Whether weight decay belongs on a parameter, by its name and shape."""
    if parameter.ndim < 2 or name.endswith(_GAINS):
        return False
    return not any(part in name for part in _TABLES)
