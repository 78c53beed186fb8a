"""What each step sees: draws that depend on (seed, step, item) alone, however they are shared out."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

from freetalk.train.engine import Engine
from freetalk.train.task import Batch, Task

_Key = tuple[int, int]


class Draws:
    """A process's shards of each step, drawn ahead by loader workers or a thread.

    Args:
        task: what is trained.
        engine: this process.
        seed: of the training.
        workers: processes that draw, two passes ahead each; 0: a thread, a step ahead.
        step: the first that is taken.
    """

    def __init__(
        self, task: Task, engine: Engine, seed: int, workers: int = 0, step: int = 0
    ) -> None:
        self._task, self._engine, self._seed = task, engine, seed
        self._items = _Items(task, seed, engine.batch_size)
        loader: DataLoader[Any] = DataLoader(
            self._items,
            batch_sampler=self._keys(step),
            collate_fn=task.collate,
            num_workers=workers,
            pin_memory=engine.device.type == "cuda",
            generator=torch.Generator(),
        )
        self._batches = iter(loader)
        self._pool = ThreadPoolExecutor(1, "draws", initializer=engine.use_device)
        self._ahead: Future[list[Batch]] = self._pool.submit(self._draw)

    def __enter__(self) -> Draws:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        del self._batches  # ends the workers

    def take(self) -> list[Batch]:
        """The batches of the next step's forward passes, on the device."""
        batches = self._ahead.result()
        self._ahead = self._pool.submit(self._draw)
        self._share_counts(batches)
        return batches

    def again(self, step: int) -> list[Batch]:
        """The batches of an earlier step, on the CPU."""
        return [self._task.collate([self._items[key] for key in keys]) for keys in self._of(step)]

    def generator(self, step: int, shard: int) -> torch.Generator:
        """Random numbers of one forward pass."""
        return torch.Generator().manual_seed(step_seed(self._seed, step, self.shard(shard)))

    def shard(self, number: int) -> int:
        """A pass of this process among all passes of the step."""
        return self._engine.rank * self._engine.accumulation + number

    def _draw(self) -> list[Batch]:
        from accelerate.utils import send_to_device

        return [  # copies from pinned memory do not wait
            send_to_device(next(self._batches), self._engine.device, non_blocking=True)
            for _ in range(self._engine.accumulation)
        ]

    def _keys(self, step: int) -> Iterator[list[_Key]]:
        while True:
            yield from self._of(step)
            step += 1

    def _of(self, step: int) -> Iterator[list[_Key]]:
        """Step and item of each of this process's passes."""
        size = self._engine.shard_size
        for number in range(self._engine.accumulation):
            first = self.shard(number) * size
            yield [(step, index) for index in range(first, first + size)]

    def _share_counts(self, batches: list[Batch]) -> None:
        if "counts" not in batches[0]:
            return
        own = torch.stack([batch["counts"] for batch in batches]).float().mean(dim=0)
        shared = self._engine.mean(own)
        for batch in batches:
            batch["counts"] = shared


class _Items(Dataset[Any]):
    """The task's items by step and place in the step."""

    def __init__(self, task: Task, seed: int, batch_size: int) -> None:
        self._task, self._seed, self._batch_size = task, seed, batch_size

    def __getitem__(self, key: _Key) -> Any:
        step, index = key
        rng = np.random.default_rng([self._seed, step, index])
        return self._task.item(rng, step * self._batch_size + index)


def step_seed(seed: int, step: int, shard: int = 0) -> int:
    """A seed for one forward pass: neighbours in seed, step or shard share nothing (splitmix64)."""
    mask = (1 << 64) - 1
    value = seed * 0x9E3779B97F4A7C15 + step * 0xD1342543DE82EF95 + shard * 0xDA942042E4DD58B5
    value = (value + 0x2545F4914F6CDD1D) & mask
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & mask
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & mask
    return (value ^ (value >> 31)) >> 1
