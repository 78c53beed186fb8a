"""Which sequence, and where in it: draws that depend on a generator alone, or on an item's number."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
import torch

from freetalk.data import MotionSequence
from freetalk.train.progress import notice


class SequenceSampler:
    """Draws sequences, each source with its share and each sequence by its length.

    Args:
        sequences: candidates.
        source_weights: share of each source; candidates of other sources are left out. Empty
            gives every source the share of its length.

    Raises:
        ValueError: no candidate is left, or a source has none.
    """

    def __init__(
        self, sequences: Sequence[MotionSequence], source_weights: dict[str, float]
    ) -> None:
        known = {s.source for s in sequences}
        for source, weight in source_weights.items():
            if source not in known and weight > 0:
                raise ValueError(
                    f"no sequences of source {source!r} here; there are {sorted(known)}"
                )
        kept = [s for s in sequences if not source_weights or source_weights.get(s.source, 0) > 0]
        if not kept:
            raise ValueError(f"none of {len(sequences)} sequences has a source with weight > 0")
        frames: dict[str, int] = {}
        for s in kept:
            frames[s.source] = frames.get(s.source, 0) + s.num_frames
        total = sum(frames.values())
        share = {
            source: source_weights.get(source, 0.0) if source_weights else count / total
            for source, count in frames.items()
        }
        weights = np.array([share[s.source] * s.num_frames / frames[s.source] for s in kept])
        self.sequences = list(kept)
        self._cumulative = np.cumsum(weights / weights.sum())

    def draw(self, rng: np.random.Generator) -> MotionSequence:
        """One sequence."""
        index = int(np.searchsorted(self._cumulative, rng.random()))
        return self.sequences[min(index, len(self.sequences) - 1)]


class Epochs:
    """Windows that show every frame of every sequence once an epoch, in an order of its own each.

    Args:
        sequences: what is shown.
        frames: of a window; a sequence's last one reaches back over the one before it.
        seed: of the orders.
    """

    def __init__(self, sequences: Sequence[MotionSequence], frames: int, seed: int) -> None:
        self._windows = [
            (s, max(0, min(first, s.num_frames - frames)))
            for s in sequences
            for first in range(0, s.num_frames, frames)
        ]
        self._seed = seed
        self._order: tuple[int, npt.NDArray[np.int64]] = (-1, np.zeros(0, np.int64))

    def __len__(self) -> int:
        return len(self._windows)

    def window(self, number: int) -> tuple[MotionSequence, int]:
        """Sequence and first frame of the training's `number`-th item."""
        epoch, place = divmod(number, len(self._windows))
        if self._order[0] != epoch:
            rng = np.random.default_rng([self._seed, epoch, 50])
            self._order = (epoch, rng.permutation(len(self._windows)))
        return self._windows[int(self._order[1][place])]


def present_weights(known: Iterable[str], source_weights: dict[str, float]) -> dict[str, float]:
    """The shares of the sources that are there; says which are left out. Empty where none is there."""
    there = sorted(set(known))
    wanted = {name: weight for name, weight in source_weights.items() if weight > 0}
    kept = {name: weight for name, weight in wanted.items() if name in there}
    missing = sorted(wanted.keys() - kept.keys())
    if missing:
        left = "the others keep their shares" if kept else "all are taken by their length"
        notice(
            f"task.source_weights: there is no source {', '.join(missing)} here; {left} "
            f"({', '.join(there)})"
        )
    return kept


def numpy_generator(generator: torch.Generator) -> np.random.Generator:
    """A NumPy generator that continues the stream of a torch one."""
    return np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
