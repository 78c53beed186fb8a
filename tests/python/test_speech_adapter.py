"""Features inside a trained model, on disk, and from a stream."""

from __future__ import annotations

import pytest
import torch

from freetalk import speech
from freetalk.speech import EncodeOptions, FeatureAdapter, SpeechEncoder, SpeechStream

SMALL = {
    "conv_dim": [16] * 7,
    "hidden_size": 32,
    "num_hidden_layers": 2,
    "num_attention_heads": 4,
    "intermediate_size": 64,
    "num_conv_pos_embeddings": 16,
    "num_conv_pos_embedding_groups": 4,
}


@pytest.fixture
def encoder() -> SpeechEncoder:
    torch.manual_seed(0)
    return SpeechEncoder(**SMALL).eval()


@pytest.mark.parametrize("resample", ["output", "conv"])
@pytest.mark.parametrize("layer", [-1, 1, "weighted"])
def test_adapter_gives_what_encode_speech_gives(
    encoder: SpeechEncoder, resample: str, layer: int | str
) -> None:
    adapter = FeatureAdapter(encoder, 25.0, layer=layer, resample=resample)
    samples = 0.1 * torch.randn(16000)
    found = adapter(speech.normalize_wave(samples)[None], 25)
    # the same sums in another order
    assert torch.allclose(found[0], adapter.encode(samples), atol=1e-4)
    assert adapter.width == found.shape[-1]


@pytest.mark.parametrize(
    ("train", "learns"),
    [("none", set()), ("transformer", {"encoder", "feature_projection"}),
     ("all", {"encoder", "feature_projection", "feature_extractor"})],
)  # fmt: skip
def test_adapter_trains_the_parts_it_is_told_to(
    encoder: SpeechEncoder, train: str, learns: set[str]
) -> None:
    adapter = FeatureAdapter(encoder, 25.0, layer="weighted", train=train).train()
    adapter(torch.randn(2, 8000), 12).square().sum().backward()
    assert adapter.layer_logits is not None
    assert adapter.layer_logits.grad is not None
    with_gradient = {
        name.split(".")[0] for name, p in encoder.named_parameters() if p.grad is not None
    }
    assert with_gradient == learns
    assert encoder.training == (train != "none")


def test_learned_layer_weights_find_the_layer_that_helps(encoder: SpeechEncoder) -> None:
    adapter = FeatureAdapter(encoder, 50.0, layer="weighted")
    wave = torch.randn(1, 8000)
    with torch.no_grad():
        target = encoder.hidden_states(wave)[1]
        target = speech.resample_features(target, 25, 50.0, encoder.timing)
    optimizer = torch.optim.Adam([p for p in adapter.parameters() if p.requires_grad], 0.2)
    for _ in range(60):
        optimizer.zero_grad()
        (adapter(wave, 25) - target).square().mean().backward()
        optimizer.step()
    weights = adapter.layer_weights
    assert weights is not None
    assert weights.argmax() == 1
    assert weights[1] > 0.9


def test_adapter_refuses_what_it_cannot_do(encoder: SpeechEncoder) -> None:
    for fields, word in (
        ({"layer": 3}, "layer"),
        ({"layer": "best"}, "layer"),
        ({"train": "conv"}, "train"),
        ({"resample": "input"}, "resample"),
        ({"fps": 0.0}, "fps"),
    ):
        with pytest.raises(ValueError, match=word):
            FeatureAdapter(encoder, **{"fps": 25.0, **fields})


def test_stream_equals_the_offline_run(encoder: SpeechEncoder) -> None:
    samples = 0.1 * torch.randn(60000)
    options = speech.stream_options()
    expected = speech.encode_speech(encoder, samples, 30, options=options)
    stream = SpeechStream(encoder, 30)
    parts = [stream.push(piece) for piece in samples.split(1600)]
    assert sum(len(part) for part in parts) / 30 > 60000 / 16000 - stream.latency_s
    found = torch.cat([*parts, stream.finish()])
    assert found.shape == expected.shape
    assert (found - expected).abs().max() < 1e-4


def test_half_precision_stays_close(encoder: SpeechEncoder) -> None:
    samples = 0.1 * torch.randn(20000)
    expected = speech.encode_speech(encoder, samples, 30)
    options = EncodeOptions(precision="bfloat16")
    found = speech.encode_speech(encoder, samples, 30, options=options)
    assert found.dtype == torch.float32
    # 8 bits of each weight and each product's result
    assert 0 < (found - expected).norm() / expected.norm() < 0.02
