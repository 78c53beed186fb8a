"""Windows of motion with what is heard: what a denoiser is shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.data import Dataset, MotionSequence, interpolate_frames
from freetalk.data.pack import FloatArray
from freetalk.train.features import FeatureCache, FeatureCopy
from freetalk.train.mosaic import Mosaics
from freetalk.train.task_options import AtsTaskOptions, DenoisingTaskOptions, FaceTalkTaskOptions

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


class AtsWindows(Windows):
    """Windows whose motion is that of the landmarks, (T, 204) m, with emotion and intensity.

    Args:
        options: how they are altered.
        corpus: whose motion it is.
        features: of the sequences' sound.
        sequences: of training; mosaics are made of them.
        shares: of their sources.
        frames: of a window, at most.
    """

    def __init__(
        self,
        options: AtsTaskOptions,
        corpus: Dataset,
        features: FeatureCache,
        sequences: Sequence[MotionSequence],
        shares: dict[str, float],
        frames: int,
    ) -> None:
        super().__init__(options, corpus, features, corpus.landmarks)
        self.frames = frames
        self._mosaic = options.mosaic
        self._sequences = list(sequences)
        self._mosaics = Mosaics(self._sequences, shares)

    def cut(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        def piece(source: MotionSequence, frames: int) -> tuple[FloatArray, FloatArray]:
            return self._piece(source, frames, rng)

        if altered and rng.random() < self._mosaic:
            audio, motion = self._mosaics.window(sequence, self.frames, piece, rng)
        else:
            audio, motion = self._piece(sequence, self.frames, rng, first, altered)
        return {
            "audio": self._altered(audio, rng) if altered else audio,
            "motion": motion.reshape(len(motion), -1),
            "emotion": np.eye(len(self.corpus.emotions), dtype=np.float32)[sequence.emotion],
            "intensity": sequence.intensity,
        }

    def stack(self, items: list[dict[str, Any]]) -> dict[str, Tensor]:
        """As of any windows, with ``emotion`` (B, E) and ``intensity`` (B,)."""
        return {
            **super().stack(items),
            "emotion": torch.from_numpy(np.stack([item["emotion"] for item in items])),
            "intensity": torch.tensor([item["intensity"] for item in items], dtype=torch.float32),
        }

    def longest(self) -> int:
        """Frames of the longest window that there is."""
        if self._mosaic > 0:
            return self.frames
        found = (copy.num_frames for s in self._sequences for copy in self.copies(s))
        return min(self.frames, max(found))


class CodeWindows(Windows):
    """Windows whose motion is codes (T, Z).

    Args:
        options: how they are altered.
        corpus: whose codes they are.
        features: of the sequences' sound; ``None`` hears their landmarks.
        rest: (Z,) code of the face at rest, about which amplitudes are changed.
    """

    target = "codes"

    def __init__(
        self,
        options: FaceTalkTaskOptions,
        corpus: Dataset,
        features: FeatureCache | None,
        rest: FloatArray,
    ) -> None:
        codes = corpus.codes if options.targets == "head" else corpus.weights
        super().__init__(options, corpus, features, codes)
        self.options, self.rest = options, rest

    def cut(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        o = self.options
        audio, codes = self._piece(sequence, o.window_frames, rng, first, altered)
        if altered:
            audio = self._altered(audio, rng)
            if o.amplitude_low < o.amplitude_high:
                amplitude = np.float32(rng.uniform(o.amplitude_low, o.amplitude_high))
                codes = self.rest + amplitude * (codes - self.rest)
        return {"audio": audio, "motion": codes}
