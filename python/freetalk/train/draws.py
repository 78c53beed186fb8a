"""What each step sees: draws that depend on (seed, step, item) alone, however they are shared out."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
import torch

from freetalk.train.engine import Engine

Batch = dict[str, Any]


class DrawsItems(Protocol):
    """A task whose items are drawn one by one: a step sees the same ones in any number of processes.

    A batch's ``counts`` (a tensor of what its sums are divided by) is replaced by the mean over the
    step's shards, so that the mean of the shards' losses is the loss of the whole.
    """

    def item(self, rng: np.random.Generator, number: int) -> Any:
        """The `number`-th item of the training; `rng` is its own."""

    def collate(self, items: list[Any]) -> Batch:
        """Items as a batch, on the CPU."""


class Draws:
    """A process's shards of each step, drawn one step ahead in a thread.

    Args:
        task: what is trained.
        engine: this process.
        seed: of the training.
    """

    def __init__(self, task: DrawsItems, engine: Engine, seed: int) -> None:
        self._task = task
        self._engine = engine
        self._seed = seed
        self._pool = ThreadPoolExecutor(1, "draws", initializer=engine.use_device)
        self._ahead: tuple[int, Future[list[Batch]]] | None = None

    def __enter__(self) -> Draws:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def take(self, step: int) -> list[Batch]:
        """The batches of a step's forward passes, on the device."""
        if self._ahead is not None and self._ahead[0] == step:
            batches = self._ahead[1].result()
        else:
            batches = self._draw(step)
        self._ahead = (step + 1, self._pool.submit(self._draw, step + 1))
        self._share_counts(batches)
        return batches

    def generator(self, step: int, shard: int) -> torch.Generator:
        """Random numbers of one forward pass."""
        return torch.Generator().manual_seed(step_seed(self._seed, step, self.shard(shard)))

    def shard(self, number: int) -> int:
        """A pass of this process among all passes of the step."""
        return self._engine.rank * self._engine.accumulation + number

    def _draw(self, step: int) -> list[Batch]:
        return [
            self._engine.to_device(self._draw_shard(step, number))
            for number in range(self._engine.accumulation)
        ]

    def _draw_shard(self, step: int, number: int) -> Batch:
        size = self._engine.shard_size
        first = self.shard(number) * size
        items = [
            self._task.item(
                np.random.default_rng([self._seed, step, index]),
                step * self._engine.batch_size + index,
            )
            for index in range(first, first + size)
        ]
        return self._task.collate(items)

    def _share_counts(self, batches: list[Batch]) -> None:
        if "counts" not in batches[0]:
            return
        own = torch.stack([batch["counts"] for batch in batches]).float().mean(dim=0)
        shared = self._engine.mean(own)
        for batch in batches:
            batch["counts"] = shared


def step_seed(seed: int, step: int, shard: int = 0) -> int:
    """A seed for one forward pass: neighbours in seed, step or shard share nothing (splitmix64)."""
    mask = (1 << 64) - 1
    value = seed * 0x9E3779B97F4A7C15 + step * 0xD1342543DE82EF95 + shard * 0xDA942042E4DD58B5
    value = (value + 0x2545F4914F6CDD1D) & mask
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & mask
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & mask
    return (value ^ (value >> 31)) >> 1
