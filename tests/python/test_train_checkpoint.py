"""Checkpoints: whole whenever the process dies, enough to go on exactly, and loadable as weights."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk import Talker, _native
from freetalk._pretrained import PRETRAINED
from freetalk.ats import Ats, AtsOptions
from freetalk.speech import SpeechEncoder, SpeechEncoderOptions
from freetalk.stm import Stm, StmOptions
from freetalk.train import load_config, run
from freetalk.train.checkpoint import find_checkpoint, load_state, save_checkpoint
from freetalk.train.weights import decays, parameter_groups

CONFIGS = Path(__file__).parents[2] / "configs"
# One thread: a fixed sum order.
QUICK = ["loop.threads=1", "loop.device=cpu", "loop.validate_every=0"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("checkpoints") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


def tensors(path: Path) -> dict[str, torch.Tensor]:
    return dict(_native.core.load_safetensors(str(path)))


def newest(out: Path, kind: str) -> Path:
    found = find_checkpoint(out / "checkpoints" / kind)
    assert found is not None
    return found


# What kills itself: before a step, or while a checkpoint is half written.
_KILL = """
import os, sys
from freetalk import _native
from freetalk.train import checkpoint, loop, run
kind, config, corpus, out, step, where, *options = sys.argv[1:]
def killing(original, matches):
    def wrapped(*arguments, **named):
        if matches(*arguments, **named):
            os.kill(os.getpid(), 9)
        return original(*arguments, **named)
    return wrapped
step = int(step)
if where == "step":
    loop.Trainer._train_step = killing(loop.Trainer._train_step, lambda self, draws: self.step == step)
else:
    saved = checkpoint.write_json
    checkpoint.write_json = killing(saved, lambda path, value: path.name == where and count(path))
    seen = []
    def count(path):
        seen.append(path)
        return len(seen) == step
run(kind, config, options, corpus, out)
"""


@pytest.mark.parametrize(
    ("kind", "where", "at"),
    # Before the first checkpoint, and between two; while one is written: the first, the last before the end.
    [
        ("ats", "step", 1),
        ("ats", "step", 5),
        ("stm", "state.json", 1),
        ("stm", "state.json", 4),
        ("stm", "last.json", 1),
        ("stm", "last.json", 4),
    ],
)
def test_a_killed_training_ends_with_the_same_weights(
    kind: str, where: str, at: int, corpus: Path, tmp_path: Path
) -> None:
    config = CONFIGS / f"{kind}_smoke.yaml"
    options = [*QUICK, "loop.max_steps=9", "loop.checkpoint_every=2"]
    killed, whole = tmp_path / "killed", tmp_path / "whole"
    arguments = [kind, str(config), str(corpus), str(killed), str(at), where, *options]
    done = subprocess.run(
        [sys.executable, "-c", _KILL, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == -9, done.stderr
    assert run(kind, config, options, corpus, killed).step == 9
    run(kind, config, options, corpus, whole)
    for file in ("model.safetensors", "model_1.safetensors"):  # the weights and their average
        ours, theirs = (tensors(newest(out, kind) / "state" / file) for out in (killed, whole))
        assert ours.keys() == theirs.keys()
        for name, value in ours.items():
            assert torch.equal(value, theirs[name]), f"{name}, killed at {where} {at}"
    assert not list((killed / "checkpoints" / kind).glob(".step_*"))


def test_a_checkpoint_is_a_folder_of_weights(corpus: Path, tmp_path: Path) -> None:
    for kind, model in (("stm", Stm), ("speech", SpeechEncoder)):
        options = [*QUICK, "loop.max_steps=2"]
        run(kind, CONFIGS / f"{kind}_smoke.yaml", options, corpus, tmp_path)
        folder = newest(tmp_path, kind)
        loaded = model.from_pretrained(folder)
        exported = model.from_pretrained(tmp_path / kind)
        for name, value in loaded.state_dict().items():
            if "diffusion_time" not in name:  # the forward pass clamps them where they are
                assert torch.equal(value, exported.state_dict()[name]), name
        record = json.loads((folder / "config.json").read_text())["training"]
        assert record["steps"] == 2 and record["config"]["loop"]["max_steps"] == 2


def test_a_checkpoint_loads_in_the_native_talker(corpus: Path, tmp_path: Path) -> None:
    options = [*QUICK, "loop.max_steps=1", "loop.max_minutes=0", "task.init=open-small"]
    options += ["loop.batch_size=1", "task.num_meshes=1", "task.source_weights.emodb=0"]
    run("stm", CONFIGS / "stm_small.yaml", options, corpus, tmp_path / "out")
    shutil.copytree(PRETRAINED / "open-small", tmp_path / "weights")
    shutil.rmtree(tmp_path / "weights" / "stm")
    newest(tmp_path / "out", "stm").rename(tmp_path / "weights" / "stm")
    Talker.from_pretrained(tmp_path / "weights", device="cpu")
    (tmp_path / "weights" / "stm" / "model.safetensors").unlink()
    with pytest.raises(RuntimeError, match=r"model\.safetensors"):
        Talker.from_pretrained(tmp_path / "weights", device="cpu")


def test_the_newest_checkpoints_stay(tmp_path: Path) -> None:
    def save(step: int) -> None:
        def write(folder: Path) -> None:
            (folder / "w").write_text(str(step))

        save_checkpoint(tmp_path, step, {}, write, keep=2)

    for step in (1, 2, 3, 3):
        save(step)
    names = sorted(path.name for path in tmp_path.glob("step_*"))
    assert names == ["step_0000003", "step_0000003_2"]
    found = find_checkpoint(tmp_path)
    assert found is not None and found.name == "step_0000003_2"
    assert load_state(found)["step"] == 3 and (found / "w").read_text() == "3"


def test_a_checkpoint_of_another_version_is_named(tmp_path: Path) -> None:
    save_checkpoint(tmp_path, 1, {}, lambda folder: None)
    state = tmp_path / "step_0000001" / "state.json"
    state.write_text(state.read_text().replace('"version": 4', '"version": 3'))
    with pytest.raises(ValueError, match="another version"):
        load_state(tmp_path / "step_0000001")


def test_a_finished_training_is_left_as_it_is(corpus: Path, tmp_path: Path) -> None:
    options = [*QUICK, "loop.max_steps=2"]
    first = run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    before = (newest(tmp_path, "stm") / "state.json").stat().st_mtime_ns
    again = run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    assert again == first
    assert (newest(tmp_path, "stm") / "state.json").stat().st_mtime_ns == before
    longer = [*QUICK, "loop.max_steps=3"]
    assert run("stm", CONFIGS / "stm_smoke.yaml", longer, corpus, tmp_path).step == 3


# Weight decay


@pytest.mark.parametrize("kind", ["ats", "stm", "speech"])
def test_decay_is_of_matrices_and_kernels_alone(kind: str) -> None:
    fields = load_config(kind, CONFIGS / f"{kind}_smoke.yaml").model
    model = {
        "ats": lambda: Ats(AtsOptions.from_dict({**fields, "audio_dim": 8})),
        "stm": lambda: Stm(StmOptions.from_dict(fields)),
        "speech": lambda: SpeechEncoder(SpeechEncoderOptions.from_dict(fields)),
    }[kind]()
    spared = ("bias", "norm", "embedding", "positions", "index_code", "null_", "diffusion_time")
    gains = ("original0",)
    names = dict(model.named_parameters())
    for name, parameter in names.items():
        is_spared = any(part in name for part in spared) or name.endswith(gains)
        assert decays(name, parameter) != is_spared, name
    groups = parameter_groups(model, 0.1)
    assert [group["weight_decay"] for group in groups] == [0.1, 0.0]
    assert sum(len(group["params"]) for group in groups) == len(names)
