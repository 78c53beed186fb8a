"""The audio door: formats, errors and damaged files."""

from __future__ import annotations

import pickle
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile

import freetalk as ft
from freetalk._ffmpeg import find_ffmpeg
from freetalk.audio import Audio, load_audio, resample, save_wav


def tone(seconds: float = 0.5, rate: int = 16000, channels: int = 1) -> np.ndarray:
    """A 300 Hz sine, the same in every channel."""
    samples = 0.5 * np.sin(2 * np.pi * 300 * np.arange(int(seconds * rate)) / rate)
    return samples if channels == 1 else np.stack([samples] * channels, axis=1)


@pytest.mark.parametrize(
    ("extension", "subtype", "tolerance"),
    [
        ("wav", "PCM_U8", 2 / 128),
        ("wav", "PCM_16", 2 / 32768),
        ("wav", "PCM_24", 1e-6),
        ("wav", "PCM_32", 1e-6),
        ("wav", "FLOAT", 1e-6),
        ("wav", "DOUBLE", 1e-6),
        ("flac", "PCM_16", 2 / 32768),
        ("flac", "PCM_24", 1e-6),
        ("aiff", "PCM_16", 2 / 32768),
        ("ogg", "VORBIS", 0.05),
    ],
)
def test_formats_hold_the_same_sound(
    tmp_path: Path, extension: str, subtype: str, tolerance: float
) -> None:
    path = tmp_path / f"sound.{extension}"
    soundfile.write(path, tone(), 16000, subtype=subtype)
    audio = ft.load_audio(path)
    assert audio.samples.dtype == np.float32
    assert len(audio) == 8000
    assert audio.duration_s == pytest.approx(0.5)
    assert np.abs(audio.samples - tone()).max() <= tolerance


def test_mp3_holds_the_sound(tmp_path: Path) -> None:
    if "MP3" not in soundfile.available_formats():
        pytest.skip("this libsndfile has no MP3")
    path = tmp_path / "sound.mp3"
    soundfile.write(path, tone(2.0, 44100), 44100)
    audio = load_audio(path)
    assert audio.duration_s == pytest.approx(2.0, abs=0.1)  # MP3 pads to whole frames
    assert np.abs(audio.samples[8000:16000]).max() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("channels", [2, 6])
def test_channels_are_averaged(tmp_path: Path, channels: int) -> None:
    samples = tone(channels=channels)
    samples[:, 0] = 0.0
    soundfile.write(tmp_path / "sound.wav", samples, 16000, subtype="FLOAT")
    expected = tone() * (channels - 1) / channels
    assert np.abs(load_audio(tmp_path / "sound.wav").samples - expected).max() < 1e-6


@pytest.mark.parametrize("rate", [8000, 22050, 44100, 48000, 192000])
def test_any_rate_becomes_16_khz(tmp_path: Path, rate: int) -> None:
    soundfile.write(tmp_path / "sound.wav", tone(1.0, rate), rate, subtype="FLOAT")
    audio = load_audio(tmp_path / "sound.wav")
    assert len(audio) == 16000
    # the first and last 20 ms see the silence around the clip
    assert np.abs(audio.samples - tone(1.0))[320:-320].max() < 1e-3


def test_audio_from_array() -> None:
    audio = Audio(tone(), 16000)
    assert audio.sample_rate_hz == 16000
    assert "0.5 s at 16000 Hz" in repr(audio)
    copied = pickle.loads(pickle.dumps(audio))
    assert np.array_equal(copied.samples, audio.samples)
    assert resample(audio, 8000).sample_rate_hz == 8000
    with pytest.raises(ValueError, match="2 dimensions"):
        Audio(tone(channels=2))
    with pytest.raises(ValueError, match="floating point"):
        Audio(np.zeros(10, np.int16))
    with pytest.raises(ValueError, match="finite"):
        Audio(np.array([0.0, np.nan]))
    with pytest.raises(ValueError, match="sample_rate_hz"):
        Audio(tone(), 0)


def test_view_outlives_the_audio() -> None:
    samples = Audio(tone()).samples
    assert np.abs(samples - tone()).max() < 1e-6
    with pytest.raises(ValueError, match="read-only"):
        samples[0] = 1.0


def test_save_wav_round_trips(tmp_path: Path) -> None:
    save_wav(tmp_path / "sound.wav", Audio(tone()), bits_per_sample=32)
    assert np.array_equal(load_audio(tmp_path / "sound.wav").samples, tone().astype(np.float32))
    assert soundfile.info(tmp_path / "sound.wav").subtype == "FLOAT"


@pytest.mark.parametrize("name", ["missing.wav", "folder", "empty.wav", "letter.wav"])
def test_errors_name_the_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.wav").touch()
    (tmp_path / "letter.wav").write_text("Dear reader, this is no recording.")
    with pytest.raises(RuntimeError, match=name):
        load_audio(tmp_path / name)


@pytest.mark.parametrize("extension", ["wav", "flac", "aiff", "ogg"])
def test_truncated_files_are_refused(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"sound.{extension}"
    soundfile.write(path, np.random.default_rng(0).normal(0, 0.1, 32000), 16000)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 3])
    with pytest.raises(RuntimeError, match=path.name):
        load_audio(path)


@pytest.mark.parametrize("extension", ["wav", "flac", "aiff", "ogg"])
def test_damaged_files_load_or_say_why(tmp_path: Path, extension: str) -> None:
    source = tmp_path / f"source.{extension}"
    soundfile.write(source, tone(0.1), 16000)
    data = np.frombuffer(source.read_bytes(), np.uint8)
    random = np.random.default_rng(5)
    path = tmp_path / f"damaged.{extension}"
    for _ in range(60):
        damaged = data.copy()
        places = random.integers(0, min(len(data), random.choice([60, len(data)])), 4)
        damaged[places] = random.integers(0, 256, 4)
        path.write_bytes(damaged.tobytes())
        try:
            audio = load_audio(path)
        except RuntimeError as error:
            assert path.name in str(error)
        else:
            assert len(audio) > 0
            assert np.isfinite(audio.samples).all()


def test_what_phones_record_is_read_through_ffmpeg(tmp_path: Path) -> None:
    program = find_ffmpeg()
    if program is None:
        pytest.skip("no ffmpeg")
    sound = Audio(np.sin(np.arange(32000) * 0.05).astype(np.float32) * 0.5, 16000)
    save_wav(tmp_path / "sound.wav", sound)
    subprocess.run(
        [program, "-v", "error", "-i", tmp_path / "sound.wav", tmp_path / "SOUND.M4A"], check=True
    )
    read = load_audio(tmp_path / "SOUND.M4A")
    # AAC works in frames of 1,024 samples and pads both ends
    assert abs(len(read.samples) - len(sound.samples)) <= 3 * 1024
    assert abs(np.abs(np.asarray(read.samples)[4000:28000]).max() - 0.5) < 0.02  # lossy
    for other in ("of-a-phone", "sound.m4v"):
        shutil.copy(tmp_path / "SOUND.M4A", tmp_path / other)
        np.testing.assert_array_equal(load_audio(tmp_path / other).samples, read.samples)
    drawn = ["-f", "lavfi", "-i", "color=size=32x32:duration=1", tmp_path / "silent.avi"]
    subprocess.run([program, "-v", "error", *drawn], check=True)
    with pytest.raises(RuntimeError, match=r"silent\.avi: holds no sound"):
        load_audio(tmp_path / "silent.avi")


def test_damaged_recordings_of_phones_are_named(tmp_path: Path) -> None:
    path = tmp_path / "sound.m4a"
    path.write_bytes(b"ftyp" * 100)
    with pytest.raises(RuntimeError, match=r"sound\.m4a"):
        load_audio(path)
