"""``freetalk live``, with small random weights."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from test_talker import write_weights

import freetalk
from freetalk.audio import save_wav
from freetalk.cli.app import main
from freetalk.cli.live import from_pcm


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(write_weights(tmp_path_factory.mktemp("weights")))


def hum(seconds: float) -> np.ndarray:
    time = np.arange(round(seconds * 16000)) / 16000
    return (0.3 * np.sin(900 * time) * (0.6 + 0.4 * np.sin(20 * time))).astype(np.float32)


def test_a_recording_plays_in_its_own_time(
    weights: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_wav(tmp_path / "a.wav", freetalk.Audio(hum(1.3), 16000))
    assert main(["live", "--pretrained", weights, "--audio", str(tmp_path / "a.wav")]) == 0
    out = capsys.readouterr().out
    assert "39 frames of 1.3 s of speech" in out
    assert "frames/s" in out and "latency" in out


def test_samples_come_from_a_pipe(
    weights: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pcm = (hum(0.5) * 32767).astype("<i2").tobytes()

    class Pipe:
        buffer = io.BytesIO(pcm)

    monkeypatch.setattr(sys, "stdin", Pipe)
    assert main(["live", "--pretrained", weights, "--audio", "-", "--vertices"]) == 0
    assert "15 frames of 0.5 s of speech" in capsys.readouterr().out


def test_pcm_is_signed_and_little_endian() -> None:
    blocks = list(from_pcm(io.BytesIO(np.array([0, 16384, -32768], "<i2").tobytes() + b"x")))
    np.testing.assert_array_equal(np.concatenate(blocks), [0.0, 0.5, -1.0])


def test_nothing_heard_is_said(
    weights: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Pipe:
        buffer = io.BytesIO(b"")

    monkeypatch.setattr(sys, "stdin", Pipe)
    assert main(["live", "--pretrained", weights, "--audio", "-"]) == 0
    assert "nothing was heard" in capsys.readouterr().out


def test_without_a_microphone_the_error_says_what_to_do(
    weights: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)  # importing it fails
    assert main(["live", "--pretrained", weights]) == 2
    error = capsys.readouterr().err
    assert "freetalk[live]" in error and "--audio FILE" in error
