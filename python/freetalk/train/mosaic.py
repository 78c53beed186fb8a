"""Windows made of several takes: joined from pieces that show the same emotion, or laid over one another.

A whole take tells by its rhythm where it comes from (separate words, running speech, a synthetic voice), and a
denoiser that sees the whole window learns to answer in that source's manner. In a mosaic a piece has to be judged by
its own sound.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data import MotionSequence, lip_opening
from freetalk.train.sequences import SequenceSampler

FloatArray = npt.NDArray[np.float32]
#: Features (T, C) and motion (T, 68, 3) of a piece of at most the given number of frames.
Piece = Callable[[MotionSequence, int], tuple[FloatArray, FloatArray]]

_SHORTEST, _LONGEST = 12, 70  # frames of a piece
_LIVELY_SHARE = (
    0.6  # of the mosaics: their pieces are the liveliest of a few, speech without pauses
)
_CANDIDATES = 5
_FADE = 4  # frames over which one piece becomes the next
_BLEND_SHAPE = (
    0.5  # of the Beta distribution of a blend's shares: mostly one window, little of the other
)


class Mosaics:
    """Joins pieces of takes of one emotion, intensity and frame rate.

    Args:
        sequences: candidates.
        source_weights: share of each source, as for :class:`SequenceSampler`.
    """

    def __init__(
        self, sequences: Sequence[MotionSequence], source_weights: dict[str, float]
    ) -> None:
        groups: dict[tuple[int, float, float], list[MotionSequence]] = {}
        for sequence in sequences:
            groups.setdefault(_kind(sequence), []).append(sequence)
        self._samplers = {}
        for kind, own in groups.items():
            present = {s.source for s in own}
            weights = {name: w for name, w in source_weights.items() if name in present and w > 0}
            self._samplers[kind] = SequenceSampler(own, weights)

    def window(
        self, first: MotionSequence, frames: int, piece: Piece, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Features (frames, C) and motion (frames, 68, 3) that begin with a piece of `first`."""
        sampler = self._samplers[_kind(first)]
        candidates = _CANDIDATES if rng.random() < _LIVELY_SHARE else 1

        def draw(source: MotionSequence) -> tuple[FloatArray, FloatArray]:
            length = int(rng.integers(_SHORTEST, _LONGEST))
            return max((piece(source, length) for _ in range(candidates)), key=_liveliness)

        audio, motion = draw(first)
        while len(audio) < frames:
            more = draw(sampler.draw(rng))
            audio, motion = faded(audio, more[0]), faded(motion, more[1])
        return audio[:frames], motion[:frames]


def _liveliness(piece: tuple[FloatArray, FloatArray]) -> float:
    """Mean opening of the inner lips in a piece."""
    return float(lip_opening(piece[1]).mean())


def _kind(sequence: MotionSequence) -> tuple[int, float, float]:
    return sequence.emotion, sequence.intensity, sequence.fps


def blended(one: dict[str, Any], other: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """A convex combination of two windows, over the frames of the shorter one.

    Args:
        one: ``audio`` (T, C), ``motion`` (T, ...), and values that do not change over time.
        other: the same of S frames.
        rng: draws the share.
    """
    frames = min(len(one["motion"]), len(other["motion"]))
    share = np.float32(rng.beta(_BLEND_SHAPE, _BLEND_SHAPE))
    cut = [
        {**w, "audio": w["audio"][:frames], "motion": w["motion"][:frames]} for w in (one, other)
    ]
    return {name: (1 - share) * cut[0][name] + share * cut[1][name] for name in one}


def faded(before: FloatArray, after: FloatArray) -> FloatArray:
    """Two pieces (T, ...) and (S, ...) as one, the end of the first fading into the second."""
    overlap = min(_FADE, len(before), len(after))
    share = (np.arange(overlap, dtype=np.float32) + 1) / (overlap + 1)
    share = share.reshape((-1,) + (1,) * (before.ndim - 1))
    joint = before[len(before) - overlap :] * (1 - share) + after[:overlap] * share
    return np.concatenate([before[: len(before) - overlap], joint, after[overlap:]])
