"""Which sequence, and where in it: draws that depend on a generator alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from freetalk.data import MotionSequence


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


def numpy_generator(generator: torch.Generator) -> np.random.Generator:
    """A NumPy generator that continues the stream of a torch one."""
    return np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
