"""Changes of audio that leave the speech as it is: level, noise, room, bandwidth, speed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import fftconvolve

from freetalk.corpus.stretch import stretched

FloatArray = npt.NDArray[np.float32]

#: How much faster than the wave a drawn voice speaks at most.
FASTEST_VOICE = 1.14
#: Spread of the size of drawn voices, and the tempos at which they speak.
_VOICE_OCTAVES = 0.2
_TEMPO = (0.88, FASTEST_VOICE)


def change_speed(wave: FloatArray, speed: float) -> FloatArray:
    """Plays a wave `speed` times as fast, pitch included; (S,) to (round(S / speed),)."""
    if speed == 1.0:
        return wave
    length = max(1, round(len(wave) / speed))
    times = np.arange(length) * speed
    return np.interp(times, np.arange(len(wave)), wave).astype(np.float32)


def change_voice(
    wave: FloatArray, rng: np.random.Generator, sample_rate_hz: int
) -> tuple[FloatArray, float]:
    """Speech as another, smaller or larger, slower or faster talker might say it.

    Pitch and formants move together, by up to a quarter of an octave either way and seldom more, and the tempo by
    itself.

    Args:
        wave: (S,) samples.
        rng: draws.
        sample_rate_hz: of the wave.

    Returns:
        (round(S / speed),) samples, and the speed: how much faster it is said.
    """
    size = float(
        2 ** np.clip(rng.normal(0, _VOICE_OCTAVES), -2 * _VOICE_OCTAVES, 2 * _VOICE_OCTAVES)
    )
    speed = float(rng.uniform(*_TEMPO))
    higher = change_speed(wave, size)
    said = stretched(higher, len(higher) * speed / len(wave), sample_rate_hz)
    return said.astype(np.float32), speed


def augment_wave(wave: FloatArray, rng: np.random.Generator, sample_rate_hz: int) -> FloatArray:
    """A room, a band limit and noise at 5 to 40 dB, each at times."""
    changed = wave
    if rng.random() < 0.4:
        changed = _reverberated(changed, rng, sample_rate_hz)
    if rng.random() < 0.4:
        changed = _tilted(changed, rng, sample_rate_hz)
    if rng.random() < 0.7:
        changed = _noisy(changed, rng)
    return changed


def _reverberated(wave: FloatArray, rng: np.random.Generator, rate: int) -> FloatArray:
    """Convolution with exponentially decaying noise; the direct sound stays first."""
    decay_s = rng.uniform(0.08, 0.5)  # 60 dB
    times = np.arange(int(decay_s * rate)) / rate
    response = rng.standard_normal(len(times)) * np.exp(-6.9 * times / decay_s)
    response *= rng.uniform(0.1, 0.7) / max(float(np.sqrt(np.square(response).sum())), 1e-9)
    response[0] = 1.0
    return fftconvolve(wave, response)[: len(wave)].astype(np.float32)


def _tilted(wave: FloatArray, rng: np.random.Generator, rate: int) -> FloatArray:
    """A spectral tilt and a low and a high cut-off, as microphones and lines have them."""
    spectrum = np.fft.rfft(wave)
    hertz = np.fft.rfftfreq(len(wave), 1 / rate)
    low, high = rng.uniform(20, 250), rng.uniform(3000, 0.5 * rate)
    response = 1 / np.sqrt(1 + (low / np.maximum(hertz, 1.0)) ** 4)
    response = response / np.sqrt(1 + (hertz / high) ** 8)
    tilt_db_per_octave = rng.uniform(-3, 3)
    octaves = np.log2(np.maximum(hertz, 50.0) / 1000.0)
    response = response * 10 ** (tilt_db_per_octave * octaves / 20)
    return np.fft.irfft(spectrum * response, n=len(wave)).astype(np.float32)


def _noisy(wave: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Noise of a random colour (white to brown)."""
    spectrum = np.fft.rfft(rng.standard_normal(len(wave)))
    bins = np.maximum(np.arange(len(spectrum)), 1)
    noise = np.fft.irfft(spectrum * bins ** -rng.uniform(0, 1), n=len(wave))
    snr_db = rng.uniform(5, 40)
    level = np.sqrt(np.square(wave).mean() / max(float(np.square(noise).mean()), 1e-20))
    return (wave + noise * level * 10 ** (-snr_db / 20)).astype(np.float32)
