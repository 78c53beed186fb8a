"""Windows of codes with what is heard: speech features, or landmarks [FaceTalk Fig. 8]."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from freetalk.data import Dataset, MotionSequence, interpolate_frames
from freetalk.data.pack import FloatArray
from freetalk.train.features import FeatureCache
from freetalk.train.task_options import FaceTalkTaskOptions


class CodeWindows:
    """Cuts windows out of sequences, altered or as they are, and stacks them.

    Args:
        options: how they are altered.
        corpus: whose codes they are.
        features: of the sequences' sound; ``None`` hears their landmarks.
        rest: (Z,) code of the face at rest, about which amplitudes are changed.
    """

    def __init__(
        self,
        options: FaceTalkTaskOptions,
        corpus: Dataset,
        features: FeatureCache | None,
        rest: FloatArray,
    ) -> None:
        self.options, self.corpus, self.features, self.rest = options, corpus, features, rest

    def codes(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Codes of frames [start, stop), (T, Z)."""
        kind = self.corpus.codes if self.options.targets == "head" else self.corpus.weights
        return kind(sequence, start, stop)

    def heard(self, sequence: MotionSequence, start: int, stop: int) -> FloatArray:
        """What is heard in frames [start, stop) of a sequence as it is, (T, C)."""
        if self.features is not None:
            return self.features.features(self.features.copies(sequence)[0], start, stop)
        landmarks = self.corpus.landmarks(sequence, start, stop)
        return landmarks.reshape(len(landmarks), -1)

    def cut(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        """A window that begins at frame `first` of a sequence, or at a drawn one."""
        o, frames = self.options, self.options.window_frames
        if self.features is None:
            drawn = int(rng.integers(max(0, sequence.num_frames - frames) + 1))
            start = drawn if first is None else first
            audio = self.heard(sequence, start, start + frames)
            codes = self.codes(sequence, start, start + frames)
        else:
            copies = self.features.copies(sequence)
            copy = copies[int(rng.integers(len(copies)))] if altered else copies[0]
            latest = max(0, copy.num_frames - frames)
            drawn = int(rng.integers(latest + 1))
            start = drawn if first is None else min(round(first / copy.speed), latest)
            audio = self.features.features(copy, start, start + frames)
            at = (start + np.arange(len(audio))) * copy.speed
            low, stop = int(at[0]), int(at[-1]) + 2
            codes = interpolate_frames(self.codes(sequence, low, stop), at - low)
            if altered:
                audio = self.features.altered(
                    audio, o.feature_noise, o.feature_shift, o.feature_dropout, rng
                )
        if altered and o.amplitude_low < o.amplitude_high:
            amplitude = np.float32(rng.uniform(o.amplitude_low, o.amplitude_high))
            codes = self.rest + amplitude * (codes - self.rest)
        return {"audio": audio, "motion": codes}

    def stack(self, items: list[dict[str, Any]]) -> dict[str, torch.Tensor]:
        """Windows padded to the longest: ``audio`` (B, T, C), ``codes`` (B, T, Z), ``valid`` (B, T)."""
        longest = max(len(item["motion"]) for item in items)
        audio = torch.zeros(len(items), longest, items[0]["audio"].shape[1])
        codes = torch.zeros(len(items), longest, len(self.rest))
        valid = torch.zeros(len(items), longest, dtype=torch.bool)
        for row, item in enumerate(items):
            frames = len(item["motion"])
            audio[row, :frames] = torch.from_numpy(item["audio"])
            codes[row, :frames] = torch.from_numpy(item["motion"])
            valid[row, :frames] = True
        return {"audio": audio, "codes": codes, "valid": valid}
