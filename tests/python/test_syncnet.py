"""Lip-sync error: weights of the public layout, the published features and distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from freetalk.evaluate.syncnet import SyncNet, _agreement, lip_sync_error, mfcc


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file as ``torch.save(model.state_dict())`` of the public code makes it."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("syncnet") / "syncnet_v2.model"
    torch.save(SyncNet().state_dict(), path)
    return path


def test_layout_is_the_public_one(weights: Path) -> None:
    shapes = {name: tuple(t.shape) for name, t in torch.load(weights, weights_only=True).items()}
    known = {
        "netcnnaud.0.weight": (64, 1, 3, 3),
        "netcnnaud.4.weight": (192, 64, 3, 3),
        "netcnnaud.8.weight": (384, 192, 3, 3),
        "netcnnaud.11.weight": (256, 384, 3, 3),
        "netcnnaud.14.weight": (256, 256, 3, 3),
        "netcnnaud.18.weight": (512, 256, 5, 4),
        "netcnnaud.19.running_var": (512,),
        "netfcaud.0.weight": (512, 512),
        "netfcaud.1.weight": (512,),
        "netfclip.3.weight": (1024, 512),
        "netcnnlip.0.weight": (96, 3, 5, 7, 7),
        "netcnnlip.4.weight": (256, 96, 1, 5, 5),
        "netcnnlip.8.weight": (256, 256, 1, 3, 3),
        "netcnnlip.14.weight": (256, 256, 1, 3, 3),
        "netcnnlip.18.weight": (512, 256, 1, 6, 6),
    }
    assert {name: shapes.get(name) for name in known} == known


@pytest.mark.slow
def test_a_clip_has_a_distance(weights: Path) -> None:
    net = SyncNet.from_file(weights)
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (12, 224, 224, 3), dtype=np.uint8)
    samples = rng.normal(0, 0.1, 12 * 640).astype(np.float32)
    found = lip_sync_error(net, frames, samples, max_offset=3, batch_size=3)
    assert found.distance > 0 and found.confidence >= 0 and abs(found.offset_frames) <= 3
    again = lip_sync_error(net, frames, samples, max_offset=3, batch_size=20)
    np.testing.assert_allclose(found[:2], again[:2], rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match=r"\(T, 224, 224, 3\)"):
        lip_sync_error(net, frames[:, :100], samples)
    with pytest.raises(ValueError, match="six frames"):
        lip_sync_error(net, frames[:5], samples)


def test_the_best_offset_is_found() -> None:
    generator = torch.Generator().manual_seed(0)
    heard = torch.randn(40, 8, generator=generator)
    seen = heard.roll(-4, 0)  # lips show what is heard four frames later
    found = _agreement(seen[:30], heard[:30], 6)
    assert found.offset_frames == -4
    assert found.distance < 0.7 * (found.distance + found.confidence)


def test_cepstra_of_a_known_signal() -> None:
    """The energy is that of the pre-emphasised samples; a tone lifts the cepstra of its own band alone."""
    times = np.arange(16000) / 16000
    tone = (0.5 * np.sin(2 * np.pi * 1000 * times)).astype(np.float32)
    found = mfcc(tone)
    assert found.shape == (13, 99)
    signal = np.rint(tone.astype(np.float64) * 32767)
    signal = np.append(signal[:1], signal[1:] - 0.97 * signal[:-1])
    spectrum = np.abs(np.fft.rfft(signal[1600:2000], 512)) ** 2 / 512
    np.testing.assert_allclose(found[0, 10], np.log(spectrum.sum()), rtol=1e-5)
    assert np.ptp(found[:, 5:95], axis=1).max() < 0.2  # a steady tone sounds steady
    louder = mfcc(2 * tone)
    np.testing.assert_allclose(louder[0] - found[0], 2 * np.log(2), atol=1e-3)
    np.testing.assert_allclose(louder[2:], found[2:], atol=0.02)


def test_cepstra_are_those_of_python_speech_features() -> None:
    reference = pytest.importorskip("python_speech_features")
    rng = np.random.default_rng(0)
    wave = (0.2 * rng.standard_normal(8000)).clip(-1, 1).astype(np.float32)
    whole = np.rint(wave.astype(np.float64) * 32767)
    np.testing.assert_allclose(mfcc(wave), reference.mfcc(whole, 16000).T, atol=1e-3)


def test_other_files_are_refused(weights: Path, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        SyncNet.from_file(tmp_path / "none.model")
    (tmp_path / "text.model").write_text("no tensors")
    with pytest.raises(ValueError, match="no tensors by name"):
        SyncNet.from_file(tmp_path / "text.model")
    state = torch.load(weights, weights_only=True)
    state["netfclip.3.weight"] = torch.zeros(7, 512)
    torch.save(state, tmp_path / "other.model")
    with pytest.raises(ValueError, match=r"netfclip.3.weight is \(7, 512\)"):
        SyncNet.from_file(tmp_path / "other.model")
