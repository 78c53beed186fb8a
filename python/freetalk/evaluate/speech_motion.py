"""Scores of landmark motion against speech: lip opening, closures, affect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freetalk import metrics
from freetalk.data.landmarks import UPPER_FACE, lip_opening
from freetalk.metrics import BILABIALS, NearestCentroid

__all__ = [
    "BILABIALS",
    "NearestCentroid",
    "affect_features",
    "closures",
    "correlation",
    "log_energy",
]

FloatArray = npt.NDArray[np.float32]


def correlation(a: FloatArray, b: FloatArray) -> float:
    """Pearson's correlation of two series (T,); 0 where one of them is constant."""
    return float(metrics.correlation(a, b))


def log_energy(wave: FloatArray, num_frames: int, fps: float, sample_rate_hz: int) -> FloatArray:
    """Log of the audio's energy around each frame (Hann window of two frames), (T,)."""
    return metrics.log_energy(wave, num_frames, fps, sample_rate_hz).float().numpy()


def closures(
    landmarks: FloatArray,
    phones: Sequence[tuple[float, float, str]],
    fps: float,
    closed_m: float = 0.0,
    share: float = 0.15,
) -> list[bool]:
    """For each p, b, m: do the lips close during the phone? See :func:`metrics.lip_closures`.

    Args:
        landmarks: (T, 68, 3) displacements, m.
        phones: (start in s, end in s, ARPABET label).
        fps: frames per second.
        closed_m: opening of closed lips; 0 is the neutral face.
        share: of the sequence's largest opening that still counts as closed.
    """
    opening = lip_opening(landmarks)
    return metrics.lip_closures(opening, phones, fps, closed=closed_m, share=share)


def affect_features(landmarks: FloatArray) -> FloatArray:
    """Mean and spread over time of the upper-face landmarks' displacements, m; (132,)."""
    features = metrics.affect_features(landmarks, vertices=list(UPPER_FACE))
    return features.float().numpy()
