"""A dataset's sound and sparse motion at one frame rate, whatever the rates of its sequences."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from freetalk.data.dataset import FloatArray, MotionDataset, MotionSequence, chosen
from freetalk.data.resampling import frames_at, resample_frames

#: Resampled sequences that are kept.
_KEPT = 64


class AtRate:
    """Landmarks, sound and sequences of a dataset at one frame rate; faces and vertices stay with the dataset.

    Args:
        base: the dataset.
        rate: frames per second.
    """

    def __init__(self, base: MotionDataset, rate: float) -> None:
        self.base, self.fps = base, rate
        self.sample_rate_hz, self.emotions = base.sample_rate_hz, base.emotions
        self._own = {s.id: s for s in base.sequences()}
        self._sequences = [self._at_rate(s) for s in self._own.values()]
        self._resampled = lru_cache(maxsize=_KEPT)(self._resample)

    @property
    def fingerprint(self) -> str:
        """That of the dataset, and the rate where it changes something."""
        changed = any(s.fps != self.fps for s in self._own.values())
        return f"{self.base.fingerprint} at {self.fps:g}" if changed else self.base.fingerprint

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Sequences of a split (all if ``None``) and of the given sources (all if ``None``)."""
        return chosen(self._sequences, split, sources)

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""
        own = self._own[sequence.id]
        if own.fps == self.fps:
            return self.base.landmarks(own, start, stop)
        return self._resampled(sequence.id)[start:stop].copy()

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the sequence at ``sample_rate_hz``, (S,) float32 in [-1, 1]."""
        return self.base.audio(self._own[sequence.id])

    def describe(self) -> dict[str, Any]:
        """What the dataset says of itself."""
        return self.base.describe()

    def _at_rate(self, own: MotionSequence) -> MotionSequence:
        if own.fps == self.fps:
            return own
        frames = frames_at(own.num_frames, own.fps, self.fps)
        return dataclasses.replace(own, fps=self.fps, num_frames=frames)

    def _resample(self, name: str) -> FloatArray:
        own = self._own[name]
        return resample_frames(self.base.landmarks(own), own.fps, self.fps)
