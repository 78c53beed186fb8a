"""Metrics that need all sequences at once: recognised emotions, intensities of speech and lips."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from freetalk import metrics
from freetalk.evaluate.ground_truth import GroundTruth

if TYPE_CHECKING:
    from freetalk.evaluate.predictions import Scores

#: Their names.
WHOLE_SET = ("emotion_rate", "slcc")


def can_recognise(labels: Sequence[str | None]) -> bool:
    """Whether two emotions have two sequences each."""
    counts = Counter(label for label in labels if label is not None)
    return sum(count > 1 for count in counts.values()) > 1


class WholeSet:
    """Gathers what is needed of each sequence, of the ground truth under the name ``''``.

    Args:
        wanted: names of the metrics that are scored.
        truth: the ground truth.
        masks: vertices by name.
    """

    def __init__(
        self, wanted: set[str], truth: GroundTruth, masks: dict[str, torch.Tensor]
    ) -> None:
        self._wanted, self._truth, self._masks = wanted & set(WHOLE_SET), truth, masks
        self._affect: dict[str, dict[str, torch.Tensor]] = {}
        self._lips: dict[str, dict[str, float]] = {}

    def add(self, system: str, name: str, samples: Sequence[torch.Tensor]) -> None:
        """Takes in the motion of a sequence; several samples count by their mean."""
        if "emotion_rate" in self._wanted:
            upper = self._masks["upper"]
            found = [metrics.affect_features(one, vertices=upper) for one in samples]
            self._affect.setdefault(system, {})[name] = torch.stack(found).mean(0)
        if "slcc" in self._wanted and all(len(one) > 1 for one in samples):
            own = [metrics.lip_intensity(one, vertices=self._masks["lips"]) for one in samples]
            self._lips.setdefault(system, {})[name] = sum(own) / len(own)

    def finish(self, scores: Scores) -> None:
        """Adds the values to the scores."""
        if "emotion_rate" in self._wanted:
            self._add_emotions(scores)
        if "slcc" in self._wanted:
            self._add_intensities(scores)

    def _add_emotions(self, scores: Scores) -> None:
        labels = {name: self._truth.emotion(name) for name in scores.names}
        counts = Counter(labels.values())
        names = [n for n in scores.names if labels[n] is not None and counts[labels[n]] > 1]
        kept = [str(labels[n]) for n in names]
        truth = torch.stack([self._affect[""][n] for n in names])
        for system, own in self._affect.items():
            hits = metrics.recognised(torch.stack([own[n] for n in names]), truth, kept)
            _store(scores, "emotion_rate", system, {n: float(h) for n, h in zip(names, hits)})
        scores.notes.append(
            f"emotion_rate: {len(set(kept))} emotions in {len(names)} sequences, chance is "
            f"{1 / len(set(kept)):.2f}"
        )

    def _add_intensities(self, scores: Scores) -> None:
        loudness: dict[str, float] = {}
        for name in scores.names:
            sound = self._truth.audio(name)
            if sound is not None:
                loudness[name] = metrics.speech_intensity(sound[0])
        for system, own in self._lips.items():
            names = [n for n in own if n in loudness]
            found = metrics.speech_lip_correlation(
                [loudness[n] for n in names],
                [own[n] for n in names],
                [scores.origins[n].speaker for n in names],
            )
            shares = {n: share for n, share in zip(names, found.shares) if not math.isnan(share)}
            _store(scores, "slcc", system, shares)


def _store(scores: Scores, metric: str, system: str, values: dict[str, float]) -> None:
    if system:
        scores.values[metric][system] = values
    else:
        scores.reference[metric] = values
