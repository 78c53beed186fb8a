"""Scores of landmark motion against speech: lip opening, closures, affect."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from freetalk.data.landmarks import UPPER_FACE, lip_opening

FloatArray = npt.NDArray[np.float32]

#: Phones that need closed lips.
BILABIALS = ("P", "B", "M")


def correlation(a: FloatArray, b: FloatArray) -> float:
    """Pearson's correlation of two series; 0 where one of them is constant."""
    if a.std() < 1e-12 or b.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def log_energy(wave: FloatArray, num_frames: int, fps: float, sample_rate_hz: int) -> FloatArray:
    """Log of the audio's energy around each frame (Hann window of two frames), (T,)."""
    half = round(sample_rate_hz / fps)
    window = np.hanning(2 * half + 1).astype(np.float32)
    padded = np.pad(wave, (half, 2 * half))
    starts = np.round(np.arange(num_frames) * sample_rate_hz / fps).astype(int)
    starts = np.minimum(starts, len(padded) - len(window))
    energy = np.array([np.square(padded[s : s + len(window)] * window).mean() for s in starts])
    floor = max(1e-10, 1e-6 * float(energy.max(initial=0.0)))
    result: FloatArray = np.log(energy + floor).astype(np.float32)
    return result


def closures(
    landmarks: FloatArray,
    phones: Sequence[tuple[float, float, str]],
    fps: float,
    closed_m: float = 0.0,
    share: float = 0.15,
) -> list[bool]:
    """For each p, b, m: do the lips close during the phone?

    Closed means an opening of at most ``closed_m + share * (largest - closed_m)``, the largest
    opening being that of the same sequence.

    Args:
        landmarks: (T, 68, 3) displacements, m.
        phones: (start in s, end in s, ARPABET label).
        fps: frames per second.
        closed_m: opening of closed lips; 0 is the neutral face.
        share: of the largest opening that still counts as closed.
    """
    opening = lip_opening(landmarks)
    limit = closed_m + share * max(float(opening.max()) - closed_m, 1e-6)
    result = []
    for start, end, label in phones:
        first, last = round(start * fps), round(end * fps)
        if label in BILABIALS and first < len(opening):
            result.append(bool(opening[first : max(last, first + 1)].min() <= limit))
    return result


def affect_features(landmarks: FloatArray) -> FloatArray:
    """Mean and spread over time of the upper-face landmarks' displacements, mm; (132,)."""
    upper = 1000 * landmarks[:, list(UPPER_FACE)].reshape(len(landmarks), -1)
    return np.concatenate([upper.mean(axis=0), upper.std(axis=0)]).astype(np.float32)


class NearestCentroid:
    """Labels a feature vector by the nearest class mean, each feature divided by its spread.

    Args:
        features: (N, F).
        labels: N class names.
    """

    def __init__(self, features: FloatArray, labels: Sequence[str]) -> None:
        names = np.array(labels)
        self.classes = sorted(set(labels))
        self._centroids = np.stack([features[names == c].mean(axis=0) for c in self.classes])
        own = np.stack([self._centroids[self.classes.index(c)] for c in labels])
        self._spread = (features - own).std(axis=0) + 0.05

    def label(self, feature: FloatArray) -> str:
        """The nearest class."""
        distances = np.square((self._centroids - feature) / self._spread).sum(axis=1)
        return self.classes[int(distances.argmin())]
