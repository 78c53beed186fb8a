"""Speech played faster or slower at its own pitch."""

from __future__ import annotations

import numpy as np

from freetalk.corpus.assets import Array

_FRAME_S = 0.032
_SEARCH_S = 0.010
_UNNOTICED = 0.02


def stretched(sound: Array, speed: float, rate_hz: int) -> np.ndarray:
    """A sound `speed` times as fast, its pitch kept (WSOLA, Verhelst and Roelands 1993).

    Frames are taken from the sound at `speed` times the step at which they are laid down, each shifted by up to 10 ms to
    where it continues the frame before it best.

    Args:
        sound: (S,) samples.
        speed: more than 0.
        rate_hz: sample rate.

    Returns:
        (round(S / speed),) samples.
    """
    length = round(len(sound) / speed)
    if abs(speed - 1) < _UNNOTICED:
        same = sound[:length].astype(np.float64)
        return np.pad(same, (0, max(0, length - len(sound))))
    step = int(0.5 * _FRAME_S * rate_hz)
    frame, search = 2 * step, int(_SEARCH_S * rate_hz)
    window = 0.5 - 0.5 * np.cos(np.pi * np.arange(frame) / step)
    margin = frame + search + round(step * speed)
    source = np.pad(sound.astype(np.float64), (margin, margin + frame))
    result = np.zeros(length + 2 * frame)
    at = margin - round(step * speed)
    for number in range(length // step + 2):
        if number > 0:
            wanted = source[at + step : at + step + frame]
            first = margin + round((number - 1) * step * speed) - search
            nearby = source[first : first + frame + 2 * search]
            power = np.convolve(np.square(nearby), np.ones(frame), mode="valid")
            likeness = np.correlate(nearby, wanted, mode="valid") / np.sqrt(power + 1e-9)
            at = first + int(np.argmax(likeness))
        result[number * step : number * step + frame] += window * source[at : at + frame]
    return result[step : step + length]
