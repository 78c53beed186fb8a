"""Running speech made of the captured syllables and words.

The takes that a model may learn from hold separate syllables and words with long pauses, so that a model learns their
rhythm: the mouth closes after every word. Here the voiced parts alone are joined, at other speeds (the voice keeps its
pitch) and levels and seldom with a pause, sound and motion alike; what is learnt on them carries over to sentences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freetalk.corpus.assets import Array, Take
from freetalk.corpus.stretch import stretched

_VOICED_DB = 25.0  # below the loudest frame of its surroundings
_SHORTEST = 4  # frames of a voiced part
_OVERLAP = 2  # frames over which a part becomes the next
_PAUSE_SHARE = 0.15  # of the joints have a pause
_PAUSE_FRAMES = (4, 15)
_SPEEDS = (0.9, 1.5)
_LEVEL_DB = 2.0  # spread of a part's level
_ROOM_LEVEL = 1e-4  # of the noise in a pause


@dataclass(frozen=True)
class Part:
    """Frames [start, stop) of a take played `speed` times as fast and `gain` times as loud.

    Without a take it is a pause of `stop - start` frames.
    """

    take: str
    start: int
    stop: int
    speed: float = 1.0
    gain: float = 1.0

    @property
    def num_frames(self) -> int:
        """Frames of the part as it is played."""
        return max(_OVERLAP + 1, round((self.stop - self.start) / self.speed))


def voiced_spans(
    take: Take, pieces: list[tuple[int, int]], samples_per_frame: float
) -> list[tuple[int, int]]:
    """Frames [start, stop) of a take in which there is voice, looked for within each of the pieces."""
    spans = []
    for first, last in pieces:
        edges = (np.arange(first, last + 1) * samples_per_frame).astype(int)
        bounds = list(zip(edges[:-1], edges[1:], strict=True))
        level = 10 * np.log10([np.square(take.audio[a:b]).mean() + 1e-9 for a, b in bounds])
        voiced = np.convolve(level > level.max() - _VOICED_DB, np.ones(3), mode="same") > 0
        steps = np.flatnonzero(np.diff(np.concatenate([[False], voiced, [False]]).astype(int)))
        for start, stop in steps.reshape(-1, 2):
            if stop - start >= _SHORTEST:
                spans.append((first + int(start), first + int(stop)))
    return spans


def draw_parts(
    rng: np.random.Generator, spans: list[tuple[str, int, int]], num_frames: int
) -> tuple[Part, ...]:
    """Parts of the spans (take, start, stop), and pauses, that last at least `num_frames`."""
    parts: list[Part] = []
    length = 0
    while length < num_frames:
        if parts and rng.random() < _PAUSE_SHARE:
            parts.append(Part("", 0, int(rng.integers(*_PAUSE_FRAMES))))
            length += parts[-1].num_frames - _OVERLAP
        take, start, stop = spans[int(rng.integers(len(spans)))]
        speed, gain = rng.uniform(*_SPEEDS), 10 ** (_LEVEL_DB * rng.normal() / 20)
        parts.append(Part(take, start, stop, float(speed), float(gain)))
        length += parts[-1].num_frames - _OVERLAP
    return tuple(parts)


def joined(
    parts: list[tuple[Part, Array, Array]],
    rng: np.random.Generator,
    samples_per_frame: float,
    rate_hz: int,
) -> tuple[Array, Array]:
    """Sound (S,) and weights (T, E) of parts, each given with the sound and weights of its frames."""
    sounds, motions = [], []
    for part, sound, weights in parts:
        frames = part.num_frames
        samples = round(frames * samples_per_frame)
        if part.take:
            sounds.append(part.gain * stretched(sound, len(sound) / samples, rate_hz))
            motions.append(_resampled(weights, frames))
        else:
            sounds.append(_ROOM_LEVEL * rng.standard_normal(samples))
            motions.append(np.zeros((frames, weights.shape[1])))
    overlap = round(_OVERLAP * samples_per_frame)
    return _faded(sounds, overlap).astype(np.float32), _faded(motions, _OVERLAP).astype(np.float32)


def _resampled(values: Array, count: int) -> np.ndarray:
    """(N, C) values at `count` evenly spaced moments, by linear interpolation; (count, C)."""
    at = np.linspace(0, len(values) - 1, count)
    low = np.minimum(at.astype(int), len(values) - 1)
    high = np.minimum(low + 1, len(values) - 1)
    share = (at - low)[:, None]
    return values[low] * (1 - share) + values[high] * share


def _faded(pieces: list[np.ndarray], overlap: int) -> np.ndarray:
    """Pieces one after another, each fading into the next over `overlap` rows."""
    length = sum(len(p) for p in pieces) - overlap * (len(pieces) - 1)
    result = np.zeros((length, *pieces[0].shape[1:]))
    rise = (np.arange(overlap) + 1.0) / (overlap + 1.0)
    rise = rise.reshape((-1,) + (1,) * (pieces[0].ndim - 1))
    at = 0
    for number, piece in enumerate(pieces):
        faded = piece.copy()
        if number > 0:
            faded[:overlap] *= rise
        if number + 1 < len(pieces):
            faded[len(faded) - overlap :] *= 1 - rise
        result[at : at + len(faded)] += faded
        at += len(faded) - overlap
    return result
