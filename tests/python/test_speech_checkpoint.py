"""Older checkpoints become safetensors; published ones are fetched, or it is said why not."""

from __future__ import annotations

import importlib
import json
import pickle
import shutil
from pathlib import Path

import pytest
import torch

from freetalk.cli import main
from freetalk.speech import SpeechEncoder, convert_checkpoint

SMALL = {
    "conv_dim": [8] * 7,
    "hidden_size": 16,
    "num_hidden_layers": 1,
    "num_attention_heads": 2,
    "intermediate_size": 32,
    "num_conv_pos_embeddings": 8,
    "num_conv_pos_embedding_groups": 4,
}
CONV = "encoder.pos_conv_embed.conv."


@pytest.fixture
def encoder() -> SpeechEncoder:
    torch.manual_seed(4)
    return SpeechEncoder(**SMALL).eval()


def older_state(encoder: SpeechEncoder) -> dict[str, torch.Tensor]:
    """Names as checkpoints of 2021 have them, with a head beside the encoder."""
    state = {"lm_head.weight": torch.zeros(3, 16), "hubert.masked_spec_embed": torch.zeros(16)}
    for name, tensor in encoder.state_dict().items():
        older = name.replace(CONV + "parametrizations.weight.original0", CONV + "weight_g")
        older = older.replace(CONV + "parametrizations.weight.original1", CONV + "weight_v")
        state[f"hubert.{older}"] = tensor.detach().clone()
    return state


@pytest.fixture
def older(encoder: SpeechEncoder, tmp_path: Path) -> Path:
    folder = tmp_path / "older"
    encoder.save_pretrained(folder)
    (folder / "model.safetensors").unlink()
    torch.save(older_state(encoder), folder / "pytorch_model.bin")
    return folder


def test_converted_checkpoint_computes_the_same(
    encoder: SpeechEncoder, older: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new"
    assert main(["speech", "convert", str(older / "pytorch_model.bin"), "--out", str(out)]) == 0
    assert "hubert" in capsys.readouterr().out
    wave = torch.randn(1, 4000)
    with torch.no_grad():
        assert torch.equal(SpeechEncoder.from_pretrained(out)(wave), encoder(wave))
    assert sorted(file.name for file in out.iterdir()) == ["config.json", "model.safetensors"]


def test_shards_are_put_together(encoder: SpeechEncoder, older: Path, tmp_path: Path) -> None:
    state = older_state(encoder)
    (older / "pytorch_model.bin").unlink()
    names = sorted(state)
    index = {name: f"part-{i % 2}.bin" for i, name in enumerate(names)}
    for shard in set(index.values()):
        torch.save({n: state[n] for n in names if index[n] == shard}, older / shard)
    (older / "pytorch_model.bin.index.json").write_text(json.dumps({"weight_map": index}))
    converted = convert_checkpoint(older, tmp_path / "new", half=True)
    assert converted.options == encoder.options
    (older / "part-1.bin").unlink()
    with pytest.raises(RuntimeError, match=r"part-1\.bin"):
        convert_checkpoint(older, tmp_path / "other")


class Trap:
    """What a hostile pickle would run."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("run",)


def test_pickles_that_run_code_are_refused(
    older: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (older / "pytorch_model.bin").write_bytes(pickle.dumps({"weight": Trap()}, 2))
    with pytest.raises(RuntimeError, match=r"pytorch_model\.bin"):
        convert_checkpoint(older, tmp_path / "new")
    torch.save({"weight": Trap()}, older / "pytorch_model.bin")
    with pytest.raises(RuntimeError, match=r"pytorch_model\.bin"):
        convert_checkpoint(older, tmp_path / "new")
    assert capsys.readouterr().out == ""
    assert not (tmp_path / "new").exists()


def test_what_does_not_fit_is_named(encoder: SpeechEncoder, older: Path, tmp_path: Path) -> None:
    state = older_state(encoder)
    key = "hubert.encoder.layers.0.attention.k_proj.bias"
    del state[key]
    state["hubert.encoder.layer_norm.weight"] = torch.zeros(3)
    torch.save(state, older / "pytorch_model.bin")
    with pytest.raises(RuntimeError, match=r"(?s)missing.*k_proj\.bias") as caught:
        convert_checkpoint(older, tmp_path / "new")
    assert "encoder.layer_norm.weight" in str(caught.value)
    (older / "config.json").unlink()
    with pytest.raises(RuntimeError, match=r"config\.json"):
        convert_checkpoint(older, tmp_path / "new")


@pytest.mark.parametrize("error", ["OfflineModeIsEnabled", "LocalEntryNotFoundError"])
def test_download_says_when_there_is_no_network(
    error: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hub = pytest.importorskip("huggingface_hub")
    errors = importlib.import_module("huggingface_hub.errors")

    def fetch(repository: str, file: str) -> str:
        raise getattr(errors, error)(f"no way to {repository}/{file}")

    monkeypatch.setattr(hub, "hf_hub_download", fetch)
    out = tmp_path / "model"
    assert main(["models", "download", "hubert-base-ls960", "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "facebook/hubert-base-ls960" in message
    assert "network" in message
    assert not out.exists()
    assert main(["models", "download", "no-such-model"]) == 2
    assert "wav2vec2-base" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["pickle", "safetensors"])
def test_download_takes_what_the_repository_has(
    kind: str,
    encoder: SpeechEncoder,
    older: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    hub = pytest.importorskip("huggingface_hub")
    errors = importlib.import_module("huggingface_hub.errors")
    if kind == "safetensors":
        encoder.save_pretrained(older)
        (older / "pytorch_model.bin").unlink()

    def fetch(repository: str, file: str) -> str:
        assert repository == "someone/some-hubert"
        if not (older / file).is_file():
            raise NotThere("404")
        return str(shutil.copy(older / file, tmp_path / "hub" / file))

    class NotThere(errors.EntryNotFoundError):
        def __init__(self, message: str) -> None:
            Exception.__init__(self, message)

    (tmp_path / "hub").mkdir()
    monkeypatch.setattr(hub, "hf_hub_download", fetch)
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    assert main(["models", "download", "someone/some-hubert"]) == 0
    loaded = SpeechEncoder.from_pretrained(tmp_path / "cache" / "models" / "some-hubert")
    wave = torch.randn(1, 4000)
    with torch.no_grad():
        assert torch.equal(loaded(wave), encoder(wave))
