"""Training from given weights: it starts where they are, or says why they do not fit."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk import _native
from freetalk._pretrained import PRETRAINED
from freetalk.data import open_dataset
from freetalk.train import load_config, run
from freetalk.train.initial import initial_weights
from freetalk.train.run import make_task

CONFIGS = Path(__file__).parents[2] / "configs"
QUICK = ["loop.threads=1", "loop.device=cpu"]
# A step this small moves no weight by more than float16 resolves.
STILL = [*QUICK, "loop.max_steps=1", "loop.validate_every=0", "loop.learning_rate=1e-12"]
# The tests' corpus has none of these sources.
START = ["task.init=open-small", "task.source_weights.emodb=0", "task.source_weights.running=0"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("initial") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


def tensors(directory: Path) -> dict[str, torch.Tensor]:
    return dict(_native.core.load_safetensors(str(directory / "model.safetensors")))


@pytest.mark.parametrize("kind", ["ats", "stm", "speech"])
def test_a_training_starts_from_the_shipped_weights(
    kind: str, corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [*STILL, *START, "loop.batch_size=1", "loop.max_minutes=0"]
    if kind == "ats":
        options += ["task.feature_augmentations=0", "task.validation_windows=1"]
    elif kind == "stm":
        options += ["task.num_meshes=1", "task.validation_windows=1"]
    run(kind, CONFIGS / f"{kind}_small.yaml", options, corpus, tmp_path)
    shipped, exported = tensors(PRETRAINED / "open-small" / kind), tensors(tmp_path / kind)
    assert shipped.keys() == exported.keys()
    for name, value in shipped.items():
        torch.testing.assert_close(exported[name], value, msg=name)
    assert str(PRETRAINED / "open-small" / kind) in capsys.readouterr().err


def test_the_motion_statistics_are_those_of_the_weights(corpus: Path, tmp_path: Path) -> None:
    options = [*QUICK, *START, "task.feature_augmentations=0"]
    config = load_config("ats", CONFIGS / "ats_small.yaml", options)
    task = make_task(config, open_dataset(corpus), tmp_path, torch.device("cpu"))
    shipped = tensors(PRETRAINED / "open-small" / "ats")
    assert torch.equal(task.mean, shipped["motion_mean"])
    assert torch.equal(task.spread, shipped["motion_scale"])


def test_a_training_starts_from_the_output_of_another(corpus: Path, tmp_path: Path) -> None:
    config = CONFIGS / "stm_smoke.yaml"
    run("stm", config, [*QUICK, "loop.max_steps=2"], corpus, tmp_path / "first")
    seeded = [*STILL, "loop.seed=5"]
    start = f"task.init={tmp_path / 'first'}"
    run("stm", config, [*seeded, start], corpus, tmp_path / "second")
    run("stm", config, seeded, corpus, tmp_path / "fresh")
    first, second, fresh = (tensors(tmp_path / n / "stm") for n in ("first", "second", "fresh"))
    for name, value in first.items():
        torch.testing.assert_close(second[name], value, msg=name)
    assert any(not torch.equal(fresh[name], value) for name, value in first.items())


def test_weights_that_do_not_fit_are_refused(corpus: Path, tmp_path: Path) -> None:
    config = CONFIGS / "stm_smoke.yaml"
    with pytest.raises(ValueError, match=r"tensor .* is \(.*\) in .*encoder_width \d+ -> 16"):
        run("stm", config, [*QUICK, "task.init=open-small"], corpus, tmp_path)
    with pytest.raises(FileNotFoundError, match=r"task\.init=nowhere: no config\.json"):
        run("stm", config, [*QUICK, "task.init=nowhere"], corpus, tmp_path)


def test_a_folder_of_weights_wins_over_an_installed_name(tmp_path: Path) -> None:
    for name in ("config.json", "model.safetensors"):
        (tmp_path / name).write_text("{}")
    assert initial_weights(str(tmp_path), "ats") == tmp_path
    assert initial_weights("open-small", "ats") == PRETRAINED / "open-small" / "ats"
