"""The speech encoder as a torch module, and features for motion frames."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

import freetalk as ft
from freetalk import speech

SMALL = {
    "conv_dim": [16] * 7,
    "hidden_size": 32,
    "num_hidden_layers": 1,
    "num_attention_heads": 4,
    "intermediate_size": 64,
    "num_conv_pos_embeddings": 16,
    "num_conv_pos_embedding_groups": 4,
}


@pytest.fixture
def encoder() -> speech.SpeechEncoder:
    torch.manual_seed(0)
    return ft.speech.SpeechEncoder(**SMALL).eval()


def test_training_lowers_a_loss(encoder: speech.SpeechEncoder) -> None:
    encoder.train()
    wave = torch.randn(2, 4000)
    target = torch.randn(2, encoder.num_frames(4000), 32)
    optimizer = torch.optim.AdamW(encoder.parameters(), 1e-3)
    losses = []
    for _ in range(30):
        optimizer.zero_grad()
        loss = (encoder(wave) - target).square().mean()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.9 * losses[0]


def test_frozen_convolutions_get_no_gradient(encoder: speech.SpeechEncoder) -> None:
    for name, parameter in encoder.named_parameters():
        parameter.requires_grad_(not name.startswith("feature_extractor."))
    encoder(torch.randn(1, 4000)).sum().backward()
    for name, parameter in encoder.named_parameters():
        assert (parameter.grad is None) == name.startswith("feature_extractor.")


def test_copies_compute_the_same(encoder: speech.SpeechEncoder) -> None:
    wave = torch.randn(1, 4000)
    for other in (copy.deepcopy(encoder), pickle.loads(pickle.dumps(encoder))):
        assert torch.equal(other(wave), encoder(wave))
    assert encoder.double()(wave.double()).dtype == torch.float64


def test_runs_under_autocast(encoder: speech.SpeechEncoder) -> None:
    wave = torch.randn(2, 4000)
    mask = torch.arange(4000) < torch.tensor([[4000], [3000]])
    with torch.no_grad():
        expected = encoder(wave, mask)
        with torch.autocast("cpu", torch.bfloat16):
            found = encoder(wave, mask)
    # bfloat16 keeps 8 bits; the output of the last norm is of order 1
    assert (found - expected).abs().max() < 0.1


@pytest.mark.parametrize("half", [False, True])
def test_save_and_load(encoder: speech.SpeechEncoder, tmp_path: Path, half: bool) -> None:
    encoder.save_pretrained(tmp_path / "speech", half=half, training={"seed": 1})
    loaded = speech.SpeechEncoder.from_pretrained(tmp_path / "speech")
    assert not loaded.training
    assert loaded.options == encoder.options
    wave = torch.randn(1, 4000)
    # float16 keeps 11 bits of each weight
    assert (loaded(wave) - encoder(wave)).abs().max() <= (2e-2 if half else 0.0)
    config = json.loads((tmp_path / "speech" / "config.json").read_text())
    assert config["training"] == {"seed": 1}
    assert config["model_type"] == "hubert"


def test_load_errors_name_the_file(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="nowhere"):
        speech.SpeechEncoder.from_pretrained(tmp_path / "nowhere")
    (tmp_path / "config.json").write_text('{"model_type": "whisper"}')
    with pytest.raises(RuntimeError, match="whisper"):
        speech.SpeechEncoder.from_pretrained(tmp_path)


def test_options_refuse_unknown_names() -> None:
    with pytest.raises(ValueError, match="hidden_size"):
        speech.SpeechEncoderOptions(hiden_size=3)
    with pytest.raises(ValueError, match="num_attention_heads"):
        speech.SpeechEncoder(num_attention_heads=7)
    assert speech.hubert_tiny().hidden_size == 192
    assert speech.hubert_large().do_stable_layer_norm
    assert speech.hubert_base() == speech.SpeechEncoderOptions()
    assert speech.wav2vec2_base().model_type == "wav2vec2"


def test_bad_waves_are_refused(encoder: speech.SpeechEncoder) -> None:
    with pytest.raises(ValueError, match="at least 400"):
        encoder(torch.randn(1, 300))
    with pytest.raises(ValueError, match=r"\(B, S\)"):
        encoder(torch.randn(4000))
    with pytest.raises(ValueError, match="gaps"):
        encoder(torch.randn(1, 4000), torch.arange(4000).flip(0)[None] < 2000)


def test_encode_speech_takes_arrays_and_reports_progress(encoder: speech.SpeechEncoder) -> None:
    samples = np.random.default_rng(0).normal(0, 0.1, 80000).astype(np.float32)
    shares: list[float] = []
    options = speech.EncodeOptions(window_s=2.0, context_s=0.5)
    features = speech.encode_speech(encoder, samples, 30, options=options, progress=shares.append)
    assert features.shape == (150, 32)
    assert shares[-1] == 1.0
    assert not features.requires_grad
    assert torch.equal(features, speech.encode_speech(encoder, samples, 30, options=options))


def test_short_clip_is_normalised_encoded_and_resampled(encoder: speech.SpeechEncoder) -> None:
    samples = 0.1 * torch.randn(16000)
    with torch.no_grad():
        hidden = encoder(speech.normalize_wave(samples)[None])
    expected = speech.resample_features(hidden, 25, 25.0, encoder.timing)[0]
    assert torch.allclose(speech.encode_speech(encoder, samples, 25), expected, atol=1e-6)


def test_resample_features_follows_time() -> None:
    times = (0.0125 + 0.02 * torch.arange(49, dtype=torch.float64))[:, None]
    found = speech.resample_features(times, 30, 30.0)[:, 0]
    expected = (torch.arange(30, dtype=torch.float64) / 30).clamp(times.min(), times.max())
    assert torch.allclose(found, expected)
    assert torch.allclose(speech.resample_features(times, 30)[:, 0], expected, atol=0.0101)
    with pytest.raises(ValueError, match="fps"):
        speech.resample_features(times, 30, timing=speech.FrameTiming())


def test_normalize_wave_matches_its_formula() -> None:
    wave = torch.randn(1000, dtype=torch.float64) * 3 + 1
    expected = (wave - wave.mean()) / (wave.var(correction=0) + 1e-7).sqrt()
    assert torch.allclose(speech.normalize_wave(wave), expected)
