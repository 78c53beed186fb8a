"""The optimiser's view of the weights: which of them decay, and their moving average."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

#: Parts of the names of tables: learned positions, embeddings of labels, codes of landmarks.
_TABLES = ("positions", "embedding", "index_code", "diffusion_time")
#: The gain of a weight-normed convolution, in both of torch's spellings.
_GAINS = ("weight.original0", "weight_g")


class Average:
    """Exponential moving average of weights; the decay rises from 0 so that early steps are forgotten.

    Args:
        model: whose weights.
        decay: of the average; 0 keeps none.
    """

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.decay = decay
        self.weights: dict[str, Tensor] = {}
        if decay > 0:
            self.weights = {name: p.detach().clone() for name, p in model.named_parameters()}

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Moves the average towards the weights after `step` steps."""
        if self.weights:
            move = get_ema_multi_avg_fn(min(self.decay, (1 + step) / (10 + step)))
            own = dict(model.named_parameters())
            move(list(self.weights.values()), [own[name].detach() for name in self.weights], step)

    @contextmanager
    @torch.no_grad()
    def applied(self, model: nn.Module) -> Iterator[None]:
        """Puts the average into the model for the duration."""
        own = {name: p.detach().clone() for name, p in model.named_parameters()}
        self._copy(model, self.weights)
        try:
            yield
        finally:
            self._copy(model, own)

    @torch.no_grad()
    def _copy(self, model: nn.Module, weights: dict[str, Tensor]) -> None:
        for name, parameter in model.named_parameters():
            if name in weights:
                parameter.copy_(weights[name])


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
