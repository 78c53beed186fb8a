from __future__ import annotations
import numpy
import os
import typing

__all__: list[str] = [
    "Audio",
    "MAX_SAMPLE_RATE_HZ",
    "MIN_SAMPLE_RATE_HZ",
    "load_audio",
    "resample",
    "save_wav",
]

class Audio:
    """
    Mono sound: float32 samples and their rate.
    """
    def __getstate__(self) -> tuple[typing.Any, int]: ...
    def __init__(
        self,
        samples: numpy.ndarray,
        sample_rate_hz: typing.SupportsInt | typing.SupportsIndex = 16000,
    ) -> None: ...
    def __len__(self) -> int: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    @property
    def duration_s(self) -> float: ...
    @property
    def sample_rate_hz(self) -> int: ...
    @property
    def samples(self) -> numpy.ndarray:
        """
        (S,) float32, read-only view
        """

def load_audio(
    path: os.PathLike | str | bytes,
    sample_rate_hz: typing.SupportsInt | typing.SupportsIndex = 16000,
) -> Audio: ...
def resample(audio: Audio, sample_rate_hz: typing.SupportsInt | typing.SupportsIndex) -> Audio: ...
def save_wav(
    path: os.PathLike | str | bytes,
    audio: Audio,
    *,
    bits_per_sample: typing.SupportsInt | typing.SupportsIndex = 16,
) -> None: ...

MAX_SAMPLE_RATE_HZ: int = 768000
MIN_SAMPLE_RATE_HZ: int = 1000
