"""Scores of speech-to-motion weights on recorded talkers: does the mouth move as theirs did?"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from freetalk.data import Dataset, lip_opening
from freetalk.evaluate.pretrained import SpeechToMotion
from freetalk.evaluate.speech_motion import correlation

FloatArray = npt.NDArray[np.float32]

#: Recorded lips that are no further apart are closed; generated ones may be a little further.
_CLOSED_M, _GENERATED_CLOSED_M = 0.0006, 0.0015
#: Lips that part further than this before and after are closed in between for a sound, not in a pause.
_OPEN_M = 0.003
_LONGEST_CLOSURE_S = 0.25
_LAGS = range(-4, 5)
_MOUTH = {"opening": lip_opening, "width": lambda moved: moved[..., 54, 0] - moved[..., 48, 0]}


def evaluate_recorded(
    dataset: Dataset, model: SpeechToMotion, split: str = "test", samples: int = 1
) -> dict[str, Any]:
    """Correlation of generated with recorded opening and width of the mouth over all clips of a split.

    Args:
        dataset: recordings with sound and landmarks.
        model: what is measured; it performs every clip under the clip's emotion.
        split: of the dataset.
        samples: performances of each clip; every figure is their mean.

    Returns:
        Of ``opening`` and ``width``: ``correlation`` over the frames of all clips, ``clips`` the mean of the
        clips' own, ``lag`` in frames at which it is largest (positive: the lips are late), ``spread`` the ratio of
        generated to recorded standard deviation; ``closures``, how many short closings of the lips were recorded,
        and ``closed``, the share of them that the generated lips close at, one frame early or late, ``None`` of none.

    Raises:
        ValueError: the split has no sequence with sound.
    """
    chosen = [s for s in dataset.sequences(split) if s.has_sound]
    if not chosen:
        raise ValueError(f"{dataset.name} has no sequence with sound in the split {split!r}")
    pairs: list[tuple[FloatArray, FloatArray]] = []
    closed: list[bool] = []
    spoken = model.perform(dataset, chosen, [list(range(samples))] * len(chosen))
    for sequence, motions in tqdm(spoken, desc=dataset.name, total=len(chosen), leave=False):
        recorded = dataset.landmarks(sequence)[: motions.shape[1]]
        for motion in motions:
            pairs.append((motion[: len(recorded)], recorded))
            closed += _closures(*pairs[-1], sequence.fps)
    scores: dict[str, Any] = {"clips": len(chosen), "frames": sum(len(p[0]) for p in pairs)}
    for name, measure in _MOUTH.items():
        series = [(measure(made), measure(true)) for made, true in pairs]
        by_lag = {lag: _at_lag(series, lag) for lag in _LAGS}
        joined = [np.concatenate(side) for side in zip(*series, strict=True)]
        scores[name] = {
            "correlation": by_lag[0],
            "clips": float(np.mean([correlation(made, true) for made, true in series])),
            "lag": max(by_lag, key=lambda lag: by_lag[lag]),
            "spread": float(joined[0].std() / max(joined[1].std(), 1e-9)),
        }
    scores["closures"] = len(closed)
    scores["closed"] = float(np.mean(closed)) if closed else None
    return scores


def _at_lag(series: list[tuple[FloatArray, FloatArray]], lag: int) -> float:
    """Correlation over all clips, the generated motion taken `lag` frames later."""
    made = np.concatenate([g[max(lag, 0) : len(g) + min(lag, 0)] for g, _ in series])
    true = np.concatenate([t[max(-lag, 0) : len(t) - max(lag, 0)] for _, t in series])
    return correlation(made, true)


def _closures(made: FloatArray, true: FloatArray, fps: float) -> list[bool]:
    """For each short closing of the recorded lips (T, 68, 3): do the generated ones close?"""
    opening, recorded = lip_opening(made), lip_opening(true)
    closed = np.concatenate([[False], recorded <= _CLOSED_M, [False]])
    edges = np.flatnonzero(np.diff(closed.astype(int))).reshape(-1, 2)
    hits = []
    for first, last in edges:
        before, after = recorded[max(0, first - 6) : first], recorded[last : last + 6]
        short = last - first <= _LONGEST_CLOSURE_S * fps
        if short and len(before) and len(after) and min(before.max(), after.max()) > _OPEN_M:
            near = opening[max(0, first - 1) : last + 1]
            hits.append(bool(near.min() <= _GENERATED_CLOSED_M))
    return hits
