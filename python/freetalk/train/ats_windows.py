"""Windows of motion with their speech features: what the audio-to-landmarks denoiser is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from freetalk.data import NUM_LANDMARKS, Dataset, MotionSequence, interpolate_frames
from freetalk.train.features import FeatureCache
from freetalk.train.mosaic import FloatArray, Mosaics
from freetalk.train.task_options import AtsTaskOptions


class AtsWindows:
    """Cuts windows out of sequences, altered or as they are, and stacks them.

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
        self.options, self.corpus, self.features = options, corpus, features
        self.frames = frames
        self._sequences = list(sequences)
        self._mosaics = Mosaics(self._sequences, shares)

    def cut(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        """A window that begins at frame `first` of a sequence, or at a drawn one."""

        def piece(
            source: MotionSequence, frames: int, given: int | None = None
        ) -> tuple[FloatArray, FloatArray]:
            copies = self.features.copies(source)
            copy = copies[int(rng.integers(len(copies)))] if altered else copies[0]
            latest = max(0, copy.num_frames - frames)
            drawn = int(rng.integers(0, latest + 1))
            start = drawn if given is None else min(round(given / copy.speed), latest)
            audio = self.features.features(copy, start, start + frames)
            at = (start + np.arange(len(audio))) * copy.speed
            low, stop = int(at[0]), int(at[-1]) + 2
            return audio, interpolate_frames(self.corpus.landmarks(source, low, stop), at - low)

        length = self.frames
        if altered and rng.random() < self.options.mosaic:
            audio, motion = self._mosaics.window(sequence, length, piece, rng)
        else:
            audio, motion = piece(sequence, length, first)
        if altered:
            o = self.options
            audio = self.features.altered(
                audio, o.feature_noise, o.feature_shift, o.feature_dropout, rng
            )
        return {
            "audio": audio,
            "motion": motion.reshape(len(motion), -1),
            "emotion": np.eye(len(self.corpus.emotions), dtype=np.float32)[sequence.emotion],
            "intensity": sequence.intensity,
        }

    def stack(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        longest = max(len(item["motion"]) for item in items)
        audio = torch.zeros(len(items), longest, self.features.width)
        motion = torch.zeros(len(items), longest, 3 * NUM_LANDMARKS)
        valid = torch.zeros(len(items), longest, dtype=torch.bool)
        emotion = torch.zeros(len(items), len(self.corpus.emotions))
        for row, item in enumerate(items):
            frames = len(item["motion"])
            audio[row, :frames] = torch.from_numpy(item["audio"])
            motion[row, :frames] = torch.from_numpy(item["motion"])
            valid[row, :frames] = True
            emotion[row] = torch.from_numpy(item["emotion"])
        intensity = torch.tensor([item["intensity"] for item in items], dtype=torch.float32)
        return {
            "audio": audio,
            "motion": motion,
            "valid": valid,
            "emotion": emotion,
            "intensity": intensity,
        }

    def longest(self) -> int:
        """Frames of the longest window that there is."""
        if self.options.mosaic > 0:
            return self.frames
        found = (copy.num_frames for s in self._sequences for copy in self.features.copies(s))
        return min(self.frames, max(found))
