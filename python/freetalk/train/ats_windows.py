"""Windows of motion with their speech features: what the audio-to-landmarks denoiser is shown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.data import Dataset, MotionSequence
from freetalk.data.pack import FloatArray
from freetalk.train.features import FeatureCache
from freetalk.train.mosaic import Mosaics
from freetalk.train.task_options import AtsTaskOptions
from freetalk.train.windows import Windows


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
