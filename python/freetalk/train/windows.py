"""Windows of motion with what is heard: what a denoiser is shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.data import Dataset, MotionSequence, interpolate_frames
from freetalk.data.pack import FloatArray
from freetalk.train.features import FeatureCache, FeatureCopy
from freetalk.train.task_options import DenoisingTaskOptions

#: Values (T, ...) of frames [start, stop) of a sequence; all that follow where `stop` is ``None``.
Motion = Callable[[MotionSequence, int, int | None], FloatArray]


class Windows(ABC):
    """Cuts windows out of sequences, altered or as they are, and stacks them.

    Args:
        options: how they are altered.
        corpus: whose motion it is.
        features: of the sequences' sound; ``None`` hears their landmarks.
        motion: what is restored from noise.
    """

    #: What a batch calls the motion.
    target = "motion"

    def __init__(
        self,
        options: DenoisingTaskOptions,
        corpus: Dataset,
        features: FeatureCache | None,
        motion: Motion,
    ) -> None:
        self.corpus, self.features, self.motion = corpus, features, motion
        self._alterations = options.feature_noise, options.feature_shift, options.feature_dropout

    def copies(self, sequence: MotionSequence) -> list[FeatureCopy]:
        """Renderings of what is heard of a sequence, the unaltered one first."""
        if self.features is None:
            return [FeatureCopy(0, sequence.num_frames, 1.0)]
        return self.features.copies(sequence)

    def heard(
        self, sequence: MotionSequence, start: int, stop: int, copy: FeatureCopy | None = None
    ) -> FloatArray:
        """What is heard in frames [start, stop) of a rendering, (T, C); of the unaltered one where none is given."""
        if self.features is not None:
            return self.features.features(copy or self.copies(sequence)[0], start, stop)
        landmarks = self.corpus.landmarks(sequence, start, stop)
        return landmarks.reshape(len(landmarks), -1)

    @abstractmethod
    def cut(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        """A window that begins at frame `first` of a sequence, or at a drawn one."""

    def stack(self, items: list[dict[str, Any]]) -> dict[str, Tensor]:
        """Windows padded to the longest: ``audio`` (B, T, C), the motion (B, T, Z), ``valid`` (B, T)."""
        frames = torch.tensor([len(item["motion"]) for item in items])
        return {
            "audio": padded([item["audio"] for item in items]),
            self.target: padded([item["motion"] for item in items]),
            "valid": torch.arange(int(frames.max())) < frames[:, None],
        }

    def _piece(
        self,
        sequence: MotionSequence,
        frames: int,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> tuple[FloatArray, FloatArray]:
        """What is heard (T, C) and the motion (T, ...) of at most so many frames, of a drawn rendering."""
        copies = self.copies(sequence)
        copy = copies[int(rng.integers(len(copies)))] if altered else copies[0]
        latest = max(0, copy.num_frames - frames)
        drawn = int(rng.integers(latest + 1))
        start = drawn if first is None else min(round(first / copy.speed), latest)
        audio = self.heard(sequence, start, start + frames, copy)
        at = (start + np.arange(len(audio))) * copy.speed
        low, stop = int(at[0]), int(at[-1]) + 2
        return audio, interpolate_frames(self.motion(sequence, low, stop), at - low)

    def _altered(self, audio: FloatArray, rng: np.random.Generator) -> FloatArray:
        if self.features is None:
            return audio
        return self.features.altered(audio, *self._alterations, rng)


def padded(rows: list[FloatArray]) -> Tensor:
    """Rows (T, C) of several lengths as one (B, T, C), zero where they have ended."""
    tensors = [torch.from_numpy(row).float() for row in rows]
    return torch.nn.utils.rnn.pad_sequence(tensors, batch_first=True)
