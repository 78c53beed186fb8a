"""Do lips move when and as much as speech asks for [Chae-Yeon et al., CVPR 2025, Sec. 5; their evaluation code]?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from freetalk.metrics._arrays import floats, mask

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array

_Floats = npt.NDArray[np.float64]

#: Width of the Gaussian that openings are smoothed with: two frames at the 30 fps of the published code.
SMOOTHING_S = 2 / 30


class IntensityCorrelation(NamedTuple):
    """How the intensities of speech and lips go together over a test set.

    Attributes:
        value: Pearson's correlation.
        shares: each clip's part of it, whose mean it is; NaN for clips that could not be compared.
    """

    value: float
    shares: list[float]


def temporal_misalignment(
    opening: Array, true_opening: Array, fps: float, *, smoothing_s: float = SMOOTHING_S
) -> float:
    """Mean temporal misalignment (MTM): how far apart lips open and close in prediction and truth.

    Both openings are smoothed and aligned by dynamic time warping of their first differences. Wherever the
    alignment joins a peak with a peak or a valley with a valley, and the predicted one lies between the true
    one's neighbours, their distance in time counts.

    The published code takes the distance of one vertex of each lip; this takes :func:`lip_opening`, which has
    the same peaks where lips part along the axis to the top of the head.

    Args:
        opening: (T,) float, the predicted lip opening, any unit.
        true_opening: (T',) float.
        fps: frames per second.
        smoothing_s: standard deviation of the Gaussian, s.

    Returns:
        ms; NaN where no peak or valley meets another.

    Raises:
        ValueError: fps is not positive, or a series is empty.
    """
    pred, true = (np.asarray(floats(x), dtype=np.float64).ravel() for x in (opening, true_opening))
    if fps <= 0 or len(pred) == 0 or len(true) == 0:
        raise ValueError(f"temporal_misalignment: {len(pred)}, {len(true)} frames at {fps} fps")
    pred, true = (_smoothed(x, smoothing_s * fps) for x in (pred, true))
    kinds, guesses = _extrema(true), _extrema(pred)
    order = sorted(kinds)
    found = []
    for i, j in _warping_path(np.diff(true, prepend=true[0]), np.diff(pred, prepend=pred[0])):
        if i in kinds and kinds[i] == guesses.get(j):
            at = order.index(i)
            before = order[at - 1] if at > 0 else 0
            after = order[at + 1] if at + 1 < len(order) else len(true) - 1
            if before <= j <= after:
                found.append(abs(i - j))
    return 1000 * float(np.mean(found)) / fps if found else math.nan


def lip_intensity(motion: Array, *, vertices: Array | None = None) -> float:
    """How much lips move: sqrt(mean_t (mean_v |m_(t+1)v - m_tv|)^2), in the motion's unit a frame.

    Args:
        motion: (T, V, 3) float.
        vertices: mask of the lips, (V,) bool or (M,) int64 indices; ``None``: all vertices.
    """
    tensor = floats(motion).double()
    chosen = mask(vertices)
    steps = (tensor if chosen is None else tensor[:, chosen]).diff(dim=0).norm(dim=-1).mean(dim=1)
    return float(steps.square().mean().sqrt())


def speech_intensity(wave: Array) -> float:
    """How loud speech is: the root mean square of its samples (S,)."""
    return float(floats(wave).double().square().mean().sqrt())


def speech_lip_correlation(
    speech: Sequence[float], lips: Sequence[float], speakers: Sequence[str]
) -> IntensityCorrelation:
    """Speech and lip intensity correlation coefficient (SLCC), over the clips of a test set.

    Each intensity is normalised over the clips of its speaker to mean 0 and standard deviation 1. The value
    of recorded motion is what a system should come near to, not 1.

    Args:
        speech: :func:`speech_intensity` of each clip.
        lips: :func:`lip_intensity` of each clip.
        speakers: whose clip it is; speakers with one clip, or no spread, are left out.

    Raises:
        ValueError: lengths differ.
    """
    if not len(speech) == len(lips) == len(speakers):
        raise ValueError(f"{len(speech)}, {len(lips)} intensities of {len(speakers)} clips")
    names = np.array(speakers)
    normal = np.full((2, len(names)), np.nan)
    for speaker in set(speakers):
        own = names == speaker
        values = np.array([speech, lips], dtype=np.float64)[:, own]
        spread = values.std(axis=1, ddof=1, keepdims=True) if own.sum() > 1 else np.zeros((2, 1))
        if (spread > 0).all():
            normal[:, own] = (values - values.mean(axis=1, keepdims=True)) / spread
    known = np.isfinite(normal).all(axis=0)
    shares = np.full(len(names), np.nan)
    if known.any():
        kept = normal[:, known]
        kept = (kept - kept.mean(axis=1, keepdims=True)) / kept.std(axis=1, keepdims=True)
        shares[known] = kept[0] * kept[1]
    value = float(shares[known].mean()) if known.any() else math.nan
    return IntensityCorrelation(value, shares.tolist())


def _smoothed(series: _Floats, sigma: float) -> _Floats:
    """Gaussian smoothing out to 4 sigma, mirrored at the ends."""
    radius = int(4 * sigma + 0.5)
    kernel = np.exp(-0.5 * np.square(np.arange(-radius, radius + 1) / max(sigma, 1e-12)))
    padded = np.pad(series, radius, mode="symmetric")
    return np.convolve(padded, kernel / kernel.sum(), mode="valid")


def _extrema(series: _Floats) -> dict[int, int]:
    """Frames of peaks (1) and valleys (-1), the middle one where several are level; ends are none."""
    edges = np.flatnonzero(np.diff(series) != 0)
    first, last = np.append(0, edges + 1), np.append(edges, len(series) - 1)
    turn = np.sign(np.diff(series[first]))
    bends = np.flatnonzero(turn[:-1] != turn[1:]) + 1
    return {int(first[k] + last[k]) // 2: int(turn[k - 1]) for k in bends}


def _warping_path(a: _Floats, b: _Floats) -> list[tuple[int, int]]:
    """Frames (of a, of b) that the cheapest warping joins, in order."""
    cost = np.abs(a[:, None] - b[None, :])
    total = np.full((len(a) + 1, len(b) + 1), np.inf)
    total[0, 0] = 0.0
    for i in range(len(a)):
        above, row = total[i], total[i + 1]
        for j in range(len(b)):
            row[j + 1] = cost[i, j] + min(above[j + 1], row[j], above[j])
    path, i, j = [], len(a), len(b)
    while i > 0 and j > 0:
        path.append((i - 1, j - 1))
        step = int(np.argmin([total[i - 1, j - 1], total[i - 1, j], total[i, j - 1]]))
        i, j = i - (step != 2), j - (step != 1)
    return path[::-1]
