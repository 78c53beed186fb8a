"""Training shared out to processes, accumulated passes and half precision: the same training."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from accelerate.state import AcceleratorState
from mini_corpus import write_mini_corpus
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from freetalk import _native
from freetalk.train import load_config, motion_loss, run
from freetalk.train.config import LoopOptions
from freetalk.train.draws import step_seed
from freetalk.train.engine import Engine, choose_device
from freetalk.train.losses import closure_error, closures, motion_counts

CONFIGS = Path(__file__).parents[2] / "configs"
# Enough to be quick on any machine, and a fixed sum order. Dropout is drawn per forward pass.
SAME = ["loop.threads=1", "loop.device=cpu", "loop.validate_every=0", "loop.max_steps=4"]
# The audio stage with all of its terms, and with items that differ in what they leave out.
MODEL = {
    "ats": [
        "model.dropout=0",
        "task.feature_augmentations=0",
        "task.closure_weight=2.0",
        "task.lip_weight=2.0",
        "task.rehearsal=0.3",
    ],
    "stm": [],
    "speech": ["model.hidden_dropout=0", "model.attention_dropout=0", "model.activation_dropout=0"],
}
KINDS = sorted(MODEL)
# Adam divides by the gradient's size, which makes whole steps of a rounding's sign.
SMALL_STEPS = "loop.learning_rate=1e-6"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("processes") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


def curves(out: Path, kind: str, prefix: str) -> dict[str, list[float]]:
    """Every logged scalar of training or validation, step by step."""
    events = EventAccumulator(str(out / "tensorboard" / kind)).Reload()
    names = [name for name in events.Tags()["scalars"] if name.startswith(prefix)]
    return {name: [event.value for event in events.Scalars(name)] for name in names}


def losses(out: Path, kind: str) -> list[float]:
    return curves(out, kind, "train/loss")["train/loss"]


def weights(out: Path, kind: str) -> dict[str, torch.Tensor]:
    folder = next((out / "checkpoints" / kind).glob("step_*"))
    return dict(_native.core.load_safetensors(str(folder / "state" / "model.safetensors")))


def assert_same_training(first: Path, second: Path, kind: str) -> None:
    """Sums over items are taken in another order: float32 rounding, which Adam's division amplifies."""
    assert losses(first, kind) == pytest.approx(losses(second, kind), rel=2e-5)
    assert len(losses(first, kind)) == 4
    there = weights(second, kind)
    for name, value in weights(first, kind).items():
        torch.testing.assert_close(value, there[name], atol=2e-4, rtol=1e-3, msg=name)


@pytest.mark.parametrize("kind", KINDS)
def test_two_processes_train_as_one_does(kind: str, corpus: Path, tmp_path: Path) -> None:
    options = [*SAME, *MODEL[kind], SMALL_STEPS]
    config = CONFIGS / f"{kind}_smoke.yaml"
    run(kind, config, options, corpus, tmp_path / "one")
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc_per_node=2"]
    command += ["-m", "freetalk.cli", "train", kind, "--config", str(config), "--data", str(corpus)]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "two"), *options],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("finished at step 4") == 1
    assert_same_training(tmp_path / "one", tmp_path / "two", kind)
    for prefix in ("train/", "val/"):
        one, two = (curves(tmp_path / name, kind, prefix) for name in ("one", "two"))
        assert one.keys() == two.keys() and len(one) > 1
        for name in one.keys() - {"train/items_per_second"}:
            assert one[name] == pytest.approx(two[name], rel=1e-6), name  # float32's rounding


@pytest.mark.parametrize("kind", KINDS)
def test_accumulated_passes_train_as_one_pass_does(kind: str, corpus: Path, tmp_path: Path) -> None:
    config = CONFIGS / f"{kind}_smoke.yaml"
    for passes in (1, 2):
        options = [*SAME, *MODEL[kind], SMALL_STEPS, f"loop.accumulation_steps={passes}"]
        run(kind, config, options, corpus, tmp_path / str(passes))
    assert_same_training(tmp_path / "1", tmp_path / "2", kind)


def test_a_batch_that_does_not_divide_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"batch_size 16 must be a multiple of 1 processes times 3"
    ):
        Engine(LoopOptions(device="cpu", batch_size=16, accumulation_steps=3))


def test_each_training_of_an_interpreter_has_its_own_device_and_precision() -> None:
    assert Engine(LoopOptions(device="cpu")).device.type == "cpu"
    Engine(LoopOptions(device="cpu", bf16=True))
    assert AcceleratorState().mixed_precision == "bf16"
    AcceleratorState().device = torch.device("cuda")  # as a training on a GPU leaves it
    assert Engine(LoopOptions(device="cpu")).device.type == "cpu"


def test_the_mean_over_shards_is_the_loss_of_all_frames() -> None:
    generator = torch.Generator().manual_seed(0)
    prediction, target = torch.randn(2, 4, 9, 5, 3, generator=generator)
    valid = torch.arange(9) < torch.tensor([9, 3, 6, 2])[:, None]
    whole = motion_loss(prediction, target, valid, 0.5, 0.2)
    halves = [slice(0, 2), slice(2, 4)]
    counts = torch.stack([motion_counts(valid[h]) for h in halves]).mean(dim=0)
    parts = [
        motion_loss(prediction[h], target[h], valid[h], 0.5, 0.2, counts=counts) for h in halves
    ]
    for name, value in whole.items():
        mean = sum(float(part[name]) for part in parts) / 2
        assert mean == pytest.approx(float(value), rel=1e-5)


def test_the_mean_over_shards_of_closures_is_that_of_all_frames() -> None:
    generator = torch.Generator().manual_seed(0)
    wanted = 0.01 * torch.rand(4, 60, generator=generator).square()
    wanted[:, ::7] = 0.0
    wanted[0] *= 0.01  # a face that hardly speaks
    guess = wanted + 0.002 * torch.rand(4, 60, generator=generator)
    valid = torch.arange(60) < torch.tensor([60, 30, 55, 20])[:, None]
    whole = float(closure_error(guess, wanted, valid, 0.005))
    halves = [slice(0, 2), slice(2, 4)]
    count = sum(float(closures(wanted[h], valid[h], 0.005).sum()) for h in halves) / 2
    parts = [
        float(closure_error(guess[h], wanted[h], valid[h], 0.005, torch.tensor(count)))
        for h in halves
    ]
    assert whole > 0.01 and parts[0] != pytest.approx(parts[1], rel=0.01)
    assert sum(parts) / 2 == pytest.approx(whole, rel=1e-6)


def test_step_seeds_differ() -> None:
    seeds = {step_seed(s, n, p) for s in range(5) for n in range(500) for p in range(8)}
    assert len(seeds) == 5 * 500 * 8


def test_fp16_without_a_gpu_is_refused() -> None:
    with pytest.raises(ValueError, match=r"loop\.fp16 needs a GPU"):
        Engine(LoopOptions(device="cpu", fp16=True))


def test_bf16_trains_close_to_float32(corpus: Path, tmp_path: Path) -> None:
    config, options = CONFIGS / "ats_smoke.yaml", [*SAME, *MODEL["ats"]]
    run("ats", config, options, corpus, tmp_path / "whole")
    run("ats", config, [*options, "loop.bf16=true"], corpus, tmp_path / "half")
    half, whole = losses(tmp_path / "half", "ats"), losses(tmp_path / "whole", "ats")
    # bfloat16 keeps 8 bits.
    assert half[0] == pytest.approx(whole[0], rel=3e-2) and half[0] != whole[0]


def test_a_state_is_that_of_one_process(corpus: Path, tmp_path: Path) -> None:
    options = [*SAME, "loop.max_steps=1"]
    run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    assert all(name.startswith("model.") for name in weights(tmp_path, "stm"))


def test_precisions_exclude_each_other() -> None:
    with pytest.raises(ValueError, match=r"bf16 and loop\.fp16 exclude each other"):
        load_config("ats", CONFIGS / "ats_smoke.yaml", ["loop.bf16=true", "loop.fp16=true"])


@pytest.mark.skipif(torch.cuda.is_available(), reason="a GPU is there")
def test_cuda_that_is_absent_is_named() -> None:
    with pytest.raises(ValueError, match="no usable GPU"):
        choose_device(LoopOptions(device="cuda"))
