"""Sound in and out: mono float samples from any file that libsndfile reads."""

from __future__ import annotations

import os
import subprocess
import tempfile
from pathlib import Path

from freetalk import _native
from freetalk._ffmpeg import SNDFILE_SUFFIXES, find_ffmpeg
from freetalk._native.audio import Audio

__all__ = ["Audio", "load_audio", "resample", "save_wav"]


def load_audio(path: str | os.PathLike[str], sample_rate_hz: int = 16000) -> Audio:
    """Reads WAV, FLAC, OGG, AIFF, MP3, ... block by block as mono sound.

    What libsndfile does not know (M4A, the sound of videos) is read through ffmpeg where it is installed. Channels are
    averaged; the result has ``round(n * sample_rate_hz / file_rate)`` samples, made by libsamplerate's best sinc converter.

    Args:
        path: the sound file.
        sample_rate_hz: rate of the result.

    Raises:
        RuntimeError: the file is missing, empty, a folder, not audio, truncated, longer than six hours, holds
            samples that are not finite or claims an absurd rate; the message names it and what to do.
        ValueError: ``sample_rate_hz`` is not between 1 kHz and 768 kHz.
    """
    try:
        return _native.audio.load_audio(os.fspath(path), sample_rate_hz)
    except RuntimeError:
        file, program = Path(path), find_ffmpeg()
        known = file.suffix.lower() in SNDFILE_SUFFIXES
        if program is None or known or not file.is_file() or file.stat().st_size == 0:
            raise
        with tempfile.TemporaryDirectory() as folder:
            decoded = Path(folder) / "sound.wav"
            source = ["-i", f"file:{file}", "-vn"]
            command = [program, "-nostdin", "-v", "error", *source, "-c:a", "pcm_f32le"]
            done = subprocess.run(
                [*command, str(decoded)], capture_output=True, check=False, text=True
            )
            if "does not contain any stream" in done.stderr:
                raise RuntimeError(f"{file}: holds no sound") from None
            if done.returncode != 0:
                raise  # libsndfile's sentence names the file and what to do
            return _native.audio.load_audio(str(decoded), sample_rate_hz)


def resample(audio: Audio, sample_rate_hz: int) -> Audio:
    """The same sound at another rate (libsamplerate, best sinc)."""
    return _native.audio.resample(audio, sample_rate_hz)


def save_wav(path: str | os.PathLike[str], audio: Audio, *, bits_per_sample: int = 16) -> None:
    """Writes a WAV atomically.

    Args:
        path: the file to write.
        audio: the sound; samples beyond [-1, 1] are clipped unless float.
        bits_per_sample: 16, 24 or 32 (float).

    Raises:
        ValueError: there are no samples.
        RuntimeError: the file can't be written.
    """
    _native.audio.save_wav(os.fspath(path), audio, bits_per_sample=bits_per_sample)
