"""What a training is of, and how it ended."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

Batch = dict[str, Any]


class Task(Protocol):
    """What differs between the trainings. Items are drawn one by one: a step sees the same ones in any number of
    processes."""

    def item(self, rng: np.random.Generator, number: int) -> Any:
        """The `number`-th item of the training; `rng` is its own. Touches no GPU: workers call it."""

    def collate(self, items: list[Any]) -> Batch:
        """Items as a batch, on the CPU."""

    @property
    def epochs(self) -> Sized | None:
        """The windows of an epoch, for ``loop.epochs``; ``None`` where the task has none."""

    @property
    def model(self) -> nn.Module:
        """What is trained; while it is evaluated, its average."""

    @model.setter
    def model(self, model: Any) -> None: ...

    def loss(self, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Scalar terms; ``loss`` is minimised."""

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Numbered records of the current weights: of every `parts`-th unit of the validation, from `part` on."""

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Scores of all records in their order; ``score`` is the one to minimise."""

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Writes the current weights for inference, with how they came to be."""


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended: ``finished`` or ``interrupted``, after how many steps, with what scores.

    Attributes:
        directory: of the weights.
        parameters: that were trained.
        lacking: one sentence on what the output folder lacks to be a folder of weights; empty where it is one.
    """

    status: str
    step: int
    scores: dict[str, float]
    directory: Path
    parameters: int
    lacking: str = ""
