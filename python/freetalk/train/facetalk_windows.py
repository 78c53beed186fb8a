"""Windows of codes with what is heard: speech features, or landmarks [FaceTalk Fig. 8]."""

from __future__ import annotations

from typing import Any

import numpy as np

from freetalk.data import Dataset, MotionSequence
from freetalk.data.pack import FloatArray
from freetalk.train.features import FeatureCache
from freetalk.train.task_options import FaceTalkTaskOptions
from freetalk.train.windows import Windows


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
