"""The encoder equals ``transformers`` at random weights: outputs, padding and gradients."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch

from freetalk.speech import SpeechEncoder, normalize_wave

transformers = pytest.importorskip("transformers")

SMALL = {
    "hidden_size": 48,
    "num_hidden_layers": 2,
    "num_attention_heads": 4,
    "intermediate_size": 96,
    "conv_dim": [32] * 7,
    "num_conv_pos_embeddings": 16,
    "num_conv_pos_embedding_groups": 4,
    "mask_time_prob": 0.0,
}
CONFIGS: dict[str, tuple[str, dict[str, Any]]] = {
    "hubert_base": ("hubert", SMALL),
    "hubert_large": (
        "hubert",
        {
            **SMALL,
            "feat_extract_norm": "layer",
            "do_stable_layer_norm": True,
            "conv_bias": True,
        },
    ),
    "wav2vec2_base": ("wav2vec2", SMALL),
    "wav2vec2_large": (
        "wav2vec2",
        {
            **SMALL,
            "feat_extract_norm": "layer",
            "do_stable_layer_norm": True,
            "conv_bias": True,
        },
    ),
    "odd_position_kernel": (
        "hubert",
        {**SMALL, "num_conv_pos_embeddings": 15, "hidden_act": "relu"},
    ),
    "uneven_widths": (
        "hubert",
        {
            **SMALL,
            "conv_dim": [8, 24, 40],
            "conv_kernel": [7, 4, 3],
            "conv_stride": [3, 3, 2],
            "conv_bias": True,
            "feat_proj_layer_norm": False,
            "layer_norm_eps": 1e-3,
            "hidden_size": 20,
            "num_attention_heads": 5,
            "num_conv_pos_embedding_groups": 5,
        },
    ),
    "layer_norm_post": (
        "wav2vec2",
        {**SMALL, "feat_extract_norm": "layer", "num_hidden_layers": 1, "hidden_act": "silu"},
    ),
}


def reference(name: str) -> Any:
    """The reference model with random weights away from their initial values."""
    kind, fields = CONFIGS[name]
    torch.manual_seed(7)
    if kind == "hubert":
        model = transformers.HubertModel(transformers.HubertConfig(**fields))
    else:
        model = transformers.Wav2Vec2Model(transformers.Wav2Vec2Config(**fields))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.05 * torch.randn_like(parameter))
    return model.eval()


def pair(name: str, folder: Path) -> tuple[Any, SpeechEncoder]:
    model = reference(name)
    model.save_pretrained(folder)
    return model, SpeechEncoder.from_pretrained(folder)


def relative_difference(ours: torch.Tensor, theirs: torch.Tensor) -> float:
    return ((ours - theirs).abs().max() / theirs.abs().max()).item()


@pytest.mark.parametrize("name", CONFIGS)
def test_output_equals_transformers(name: str, tmp_path: Path) -> None:
    model, encoder = pair(name, tmp_path)
    wave = normalize_wave(torch.randn(2, 9000))
    with torch.no_grad():
        theirs = model(wave).last_hidden_state
        ours = encoder(wave)
    assert ours.shape == theirs.shape
    # float32 rounding through a few layers
    assert relative_difference(ours, theirs) < 1e-5


@pytest.mark.parametrize("name", CONFIGS)
def test_blocks_equal_transformers(name: str, tmp_path: Path) -> None:
    model, encoder = pair(name, tmp_path)
    wave = normalize_wave(torch.randn(2, 9000))
    assert_blocks_agree(model, encoder, wave)
    with torch.enable_grad():  # the modules, as in training
        assert_blocks_agree(model, encoder, wave)


def assert_blocks_agree(model: Any, encoder: SpeechEncoder, wave: torch.Tensor) -> None:
    """Convolutions, what the first layer gets, each layer and the last norm, each within float32 rounding."""
    with torch.no_grad():
        theirs = model(wave, output_hidden_states=True)
        convolved = model.feature_extractor(wave).transpose(1, 2)
    states = encoder.hidden_states(wave)
    assert relative_difference(encoder.extract_features(wave), convolved) < 1e-5
    assert len(states) == len(theirs.hidden_states)
    # Versions of transformers differ in whether the last of these has passed the stable variant's final norm.
    for ours, expected in zip(states[:-1], theirs.hidden_states[:-1], strict=True):
        assert relative_difference(ours, expected) < 2e-5
    assert relative_difference(states[-1], theirs.last_hidden_state) < 2e-5


LARGE = {"hidden_size": 1024, "num_attention_heads": 16, "intermediate_size": 4096}
STABLE = {"feat_extract_norm": "layer", "do_stable_layer_norm": True, "conv_bias": True}


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("hubert", {}),
        ("hubert", {**LARGE, **STABLE}),
        ("wav2vec2", {}),
        ("wav2vec2", LARGE),
        ("wav2vec2", {**LARGE, **STABLE}),
    ],
    ids=["hubert_base", "hubert_large", "wav2vec2_base", "wav2vec2_large", "wav2vec2_large_lv60"],
)
@pytest.mark.slow
def test_published_widths_equal_transformers(kind: str, fields: dict[str, Any]) -> None:
    names = {
        "hubert": ("HubertConfig", "HubertModel"),
        "wav2vec2": ("Wav2Vec2Config", "Wav2Vec2Model"),
    }
    config, network = (getattr(transformers, name) for name in names[kind])
    torch.manual_seed(11)
    model = network(config(**fields, num_hidden_layers=2, mask_time_prob=0.0)).eval()
    encoder = SpeechEncoder(model_type=kind, num_hidden_layers=2, **fields).eval()
    state = {key: value for key, value in model.state_dict().items() if key != "masked_spec_embed"}
    encoder.load_state_dict(state)
    lengths = [16000, 9000]
    mask = (torch.arange(16000) < torch.tensor(lengths)[:, None]).long()
    wave = normalize_wave(torch.randn(2, 16000), mask)
    with torch.no_grad():
        assert_blocks_agree(model, encoder, wave)
        theirs = model(wave, attention_mask=mask).last_hidden_state
        ours = encoder(wave, mask)
    for row, length in enumerate(lengths):
        frames = encoder.num_frames(length)
        assert relative_difference(ours[row, :frames], theirs[row, :frames]) < 2e-5


@pytest.mark.parametrize("name", CONFIGS)
def test_padded_batch_equals_transformers(name: str, tmp_path: Path) -> None:
    model, encoder = pair(name, tmp_path)
    lengths = [9000, 6123, 4000]
    mask = (torch.arange(9000) < torch.tensor(lengths)[:, None]).long()
    wave = normalize_wave(torch.randn(3, 9000), mask)
    with torch.no_grad():
        theirs = model(wave, attention_mask=mask).last_hidden_state
        ours = encoder(wave, mask)
    for row, length in enumerate(lengths):
        frames = encoder.num_frames(length)
        assert relative_difference(ours[row, :frames], theirs[row, :frames]) < 1e-5


@pytest.mark.parametrize("name", CONFIGS)
def test_gradients_equal_transformers(name: str, tmp_path: Path) -> None:
    model, encoder = pair(name, tmp_path)
    mask = (torch.arange(6000) < torch.tensor([[6000], [4321]])).long()
    wave = normalize_wave(torch.randn(2, 6000), mask)
    frames = encoder.num_frames(4321)
    target = torch.randn(2, frames, encoder.options.hidden_size)
    (model(wave, attention_mask=mask).last_hidden_state[:, :frames] * target).sum().backward()
    (encoder(wave, mask)[:, :frames] * target).sum().backward()
    theirs = dict(model.named_parameters())
    ours = dict(encoder.named_parameters())
    assert ours.keys() == theirs.keys()
    scale = max(parameter.grad.abs().max() for parameter in theirs.values())
    for key, parameter in ours.items():
        expected = theirs[key].grad
        # sums over thousands of samples in another order; a bias before a norm has gradient 0 but for rounding
        torch.testing.assert_close(
            parameter.grad,
            expected,
            rtol=2e-4,
            atol=float(1e-4 * expected.abs().max() + 1e-6 * scale),
        )


@pytest.mark.parametrize("kind", ["HubertForCTC", "Wav2Vec2ForCTC"])
def test_task_checkpoint_loads_without_its_head(kind: str, tmp_path: Path) -> None:
    config_type = transformers.HubertConfig if "Hubert" in kind else transformers.Wav2Vec2Config
    model = getattr(transformers, kind)(config_type(**{**SMALL, "mask_time_prob": 0.05})).eval()
    model.save_pretrained(tmp_path)
    encoder = SpeechEncoder.from_pretrained(tmp_path)
    wave = torch.randn(1, 4000)
    with torch.no_grad():
        theirs = getattr(model, model.base_model_prefix)(wave).last_hidden_state
        assert relative_difference(encoder(wave), theirs) < 1e-5


def test_transformers_reads_what_we_save(tmp_path: Path) -> None:
    torch.manual_seed(3)
    encoder = SpeechEncoder(
        **{key: value for key, value in SMALL.items() if key != "mask_time_prob"}
    ).eval()
    encoder.save_pretrained(tmp_path, training={"seed": 3})
    model = transformers.HubertModel.from_pretrained(tmp_path).eval()
    wave = torch.randn(1, 4000)
    with torch.no_grad():
        assert relative_difference(encoder(wave), model(wave).last_hidden_state) < 1e-5
