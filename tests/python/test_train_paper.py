"""The papers' configurations train as the papers do: units, epochs, positions, frame rates, batches."""

from __future__ import annotations

import copy
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from dataset_layouts import packed, write_folder
from mini_corpus import write_mini_corpus

from freetalk.ats import Ats
from freetalk.data import Dataset, open_dataset
from freetalk.data.resampling import frames_at, resample_frames
from freetalk.train import load_config, run
from freetalk.train.config import LoopOptions
from freetalk.train.draws import Draws
from freetalk.train.engine import Engine
from freetalk.train.loop import Trainer
from freetalk.train.run import make_task

CONFIGS = Path(__file__).parents[2] / "configs"
# The papers' options in networks of seconds.
SMALL = {
    "ats": ["d_model=16", "num_layers=1", "num_heads=2", "ff_dim=16", "dropout=0"],
    "stm": [
        "encoder_width=8", "encoder_blocks=1", "feature_dim=8", "decoder_width=8", "decoder_blocks=1",
        "k_eig=8", "gcn_layers=1", "gcn_hidden=8", "attention_heads=2", "attention_dim=8",
    ],
}  # fmt: skip
TASK = {"ats": ["task.speech_encoder=open-small"], "stm": ["task.frames=20"]}
QUICK = ["loop.threads=1", "loop.device=cpu", "loop.bf16=false"]


def options(kind: str) -> list[str]:
    return [*QUICK, *(f"model.{option}" for option in SMALL[kind]), *TASK[kind]]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("paper") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


def task_of(kind: str, corpus: Dataset, out: Path, *more: str) -> Any:
    config = load_config(kind, CONFIGS / f"{kind}_paper.yaml", [*options(kind), *more])
    return config, make_task(config, corpus, out, torch.device("cpu"))


def first_updates(task: Any, batch: dict[str, Any], scale: float) -> dict[str, torch.Tensor]:
    """What AdamW's first step, of the papers' learning rate, changes for a loss times `scale`."""
    state = copy.deepcopy(task.model.state_dict())
    optimizer = torch.optim.AdamW(task.model.parameters(), lr=1e-4, weight_decay=0.0)
    (scale * task.loss(batch, torch.Generator())["loss"]).backward()
    torch.nn.utils.clip_grad_norm_(task.model.parameters(), scale)  # the papers' 1.0
    optimizer.step()
    optimizer.zero_grad()
    changes = {n: p.detach() - state[n] for n, p in task.model.named_parameters()}
    task.model.load_state_dict(state)
    return changes


@pytest.mark.parametrize("kind", ["ats", "stm"])
def test_the_learning_rate_sets_the_steps_and_not_adams_epsilon(
    kind: str, corpus: Path, tmp_path: Path
) -> None:
    _, task = task_of(kind, open_dataset(corpus), tmp_path)
    items = [task.item(np.random.default_rng(n), n) for n in range(2)]
    batch = task.collate(items)
    ours, rescaled = (first_updates(task, batch, scale) for scale in (1.0, 1000.0))
    moved = torch.cat([change.flatten().abs() for change in rescaled.values()])
    # An update is lr g / (|g| + epsilon): where the rescaled loss takes whole steps, ours does within 5 %.
    whole = moved > 0.999e-4
    assert whole.sum() > 20  # of a mesh network the last layer, which starts from zero
    own = torch.cat([change.flatten().abs() for change in ours.values()])[whole]
    assert float(own.mean()) > 0.95e-4


def test_both_stages_count_square_millimetres(corpus: Path, tmp_path: Path) -> None:
    for kind in ("ats", "stm"):
        _, task = task_of(kind, open_dataset(corpus), tmp_path / kind)
        batch = task.collate([task.item(np.random.default_rng(0), 0)])
        with torch.no_grad():
            for parameter in task.model.parameters():
                parameter.zero_()  # the answer is the mean motion, or none
            found = float(task.loss(batch, torch.Generator())["position"])
        if kind == "stm":
            expected = 1e6 * float(batch["items"][0]["target"].square().sum(-1).mean())
        else:
            spread = batch["motion"] - task.mean
            expected = 1e6 * float(spread.unflatten(-1, (68, 3)).square().sum(-1).mean())
        assert found == pytest.approx(expected, rel=1e-4)  # float32 sums in another order


# Epochs


@pytest.mark.parametrize("kind", ["ats", "stm"])
def test_an_epoch_shows_every_frame(kind: str, corpus: Path, tmp_path: Path) -> None:
    more = ["model.max_frames=32"] if kind == "ats" else []
    _, task = task_of(kind, open_dataset(corpus), tmp_path, *more)
    frames = 32 if kind == "ats" else 20
    sequences = task.sampler.sequences if kind == "ats" else task.windows.sampler.sequences
    orders = []
    for epoch in range(2):
        seen = {s.id: np.zeros(s.num_frames, bool) for s in sequences}
        numbers = range(epoch * len(task.epochs), (epoch + 1) * len(task.epochs))
        windows = [task.epochs.window(number) for number in numbers]
        for sequence, start in windows:
            seen[sequence.id][start : start + frames] = True
        assert all(frames.all() for frames in seen.values())
        orders.append([(sequence.id, start) for sequence, start in windows])
    assert sorted(orders[0]) == sorted(orders[1]) and orders[0] != orders[1]
    # What a step is given is the window of its number.
    sequence, start = task.epochs.window(3)
    item = task.item(np.random.default_rng(0), 3)
    whole = open_dataset(corpus).landmarks(sequence)[start : start + frames]
    shown = item["motion"] if kind == "ats" else item["landmarks"].numpy()
    np.testing.assert_allclose(
        shown.reshape(len(shown), -1), whole.reshape(len(whole), -1), atol=1e-6
    )


def test_epochs_set_the_steps(corpus: Path, tmp_path: Path) -> None:
    config, task = task_of(
        "stm", open_dataset(corpus), tmp_path, "loop.batch_size=4", "loop.epochs=3"
    )
    trainer = Trainer(task, config, tmp_path, "data")
    windows = sum(-(-s.num_frames // 20) for s in open_dataset(corpus).sequences("train"))
    assert trainer.max_steps == -(-3 * windows // 4)
    with pytest.raises(ValueError, match=r"loop\.epochs shows everything once"):
        load_config("stm", CONFIGS / "stm_paper.yaml", ["task.source_weights={rom: 1}"])


def test_items_are_numbered_over_steps_and_passes() -> None:
    class Numbers:
        def item(self, rng: np.random.Generator, number: int) -> int:
            return number

        def collate(self, items: list[int]) -> dict[str, Any]:
            return {"items": items}

    engine = Engine(LoopOptions(device="cpu", batch_size=6, accumulation_steps=2))
    with Draws(Numbers(), engine, 0) as draws:
        found = [batch["items"] for _ in range(3) for batch in draws.take()]
        again = [batch["items"] for batch in draws.again(1)]
    assert found == [[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11], [12, 13, 14], [15, 16, 17]]
    assert again == found[2:4]
    with Draws(Numbers(), engine, 0, workers=2, step=1) as draws:
        later = [batch["items"] for _ in range(2) for batch in draws.take()]
    assert later == found[2:]


# Positions


def test_short_sequences_train_every_position(corpus: Path, tmp_path: Path) -> None:
    for offsets, reached in ((True, 200), (False, 90)):
        _, task = task_of(
            "ats",
            open_dataset(corpus),
            tmp_path / str(offsets),
            "model.max_frames=200",
            f"task.position_offsets={str(offsets).lower()}",
        )
        rng = np.random.default_rng(0)
        task.loss(task.collate([task.item(rng, n) for n in range(48)]), torch.Generator())[
            "loss"
        ].backward()
        gradient = dict(task.model.named_parameters())["target_positions"].grad
        longest = max(s.num_frames for s in task.sampler.sequences)
        assert longest <= 90  # the corpus's
        assert int((gradient.abs().sum(dim=1) > 0).nonzero().max()) + 1 > 0.9 * reached
        assert int((gradient.abs().sum(dim=1) > 0).sum()) <= reached


@pytest.mark.slow
def test_weights_know_the_longest_window_they_were_shown(corpus: Path, tmp_path: Path) -> None:
    base = [*options("ats"), "loop.epochs=0", "loop.max_steps=1", "loop.batch_size=2"]
    for out, length in ((tmp_path / "short", 40), (tmp_path / "long", 300)):
        run("ats", CONFIGS / "ats_paper.yaml", [*base, f"model.max_frames={length}"], corpus, out)
        trained = Ats.from_pretrained(out / "ats").options.trained_frames
        longest = max(s.num_frames for s in open_dataset(corpus).sequences("train") if s.has_sound)
        assert trained == min(length, longest)


# Frame rates


def test_resampling_keeps_what_both_rates_can_show() -> None:
    def wave(fps: float, hertz: float, frames: int) -> np.ndarray:
        return np.sin(2 * np.pi * hertz * np.arange(frames) / fps + 1)[:, None].astype(np.float32)

    inside = slice(15, -15)  # the filter reaches 10 frames of the slower rate
    for fps, rate in ((25, 30), (30, 25), (60, 30), (24, 30), (30, 29.97)):
        count = frames_at(200, fps, rate)
        found = resample_frames(wave(fps, 4, 200), fps, rate)
        assert len(found) == count
        # The filter's ripple; straight lines between frames are off by 12 % at 25 fps.
        np.testing.assert_allclose(found[inside], wave(rate, 4, count)[inside], atol=0.01)
    # 13 Hz would come back as 7 Hz at 20 fps.
    assert np.abs(resample_frames(wave(60, 13, 300), 60, 20)[inside]).max() < 0.05
    still = np.full((40, 68, 3), 0.003, np.float32)
    np.testing.assert_allclose(resample_frames(still, 25, 30), 0.003, rtol=1e-3)  # the ripple
    assert resample_frames(still[:1], 25, 30).shape == (1, 68, 3)


def test_a_dataset_at_a_rate_is_the_motion_resampled(tmp_path: Path) -> None:
    base = open_dataset(packed(write_folder(tmp_path / "own", frames=50, fps=25)))
    at_30, at_25 = base.at(30.0), base.at(25.0)
    for own, changed in zip(base.sequences(), at_30.sequences(), strict=True):
        assert (changed.fps, changed.num_frames) == (30.0, frames_at(own.num_frames, 25, 30))
        whole = resample_frames(base.landmarks(own), 25, 30)
        np.testing.assert_array_equal(at_30.landmarks(changed, 7, 20), whole[7:20])
        np.testing.assert_array_equal(at_30.audio(changed), base.audio(own))
        np.testing.assert_array_equal(at_25.landmarks(own, 3), base.landmarks(own, 3))
    assert at_25.fingerprint == base.fingerprint != at_30.fingerprint


# What the files say


@pytest.mark.parametrize("name", ["ats_paper", "stm_paper"])
def test_the_torchrun_line_of_a_paper_config_divides_its_batch(name: str) -> None:
    path = CONFIGS / f"{name}.yaml"
    line = next(line for line in path.read_text().splitlines() if "torchrun" in line)
    words = shlex.split(line.removeprefix("#"))
    processes = int(words[words.index("--nproc_per_node") + 1])
    overrides = [word for word in words if word.startswith(("loop.", "task.", "model."))]
    kind = words[words.index("train") + 1]
    loop = load_config(kind, path, overrides).loop
    assert loop.batch_size % (processes * loop.accumulation_steps) == 0


def test_paper_configs_are_the_papers() -> None:
    ats = load_config("ats", CONFIGS / "ats_paper.yaml")
    stm = load_config("stm", CONFIGS / "stm_paper.yaml")
    assert ats.model["attention_start"] == "random"
    assert (ats.loop.epochs, stm.loop.epochs, ats.loop.batch_size) == (100, 30, 16)
    for config in (ats, stm):
        loop = config.loop
        assert (loop.learning_rate, loop.weight_decay, loop.lr_schedule) == (1e-4, 1e-2, "constant")


def test_the_paper_never_hears_through_an_encoder_that_nobody_named(
    corpus: Path, tmp_path: Path
) -> None:
    unnamed = [option for option in options("ats") if "speech_encoder" not in option]
    with pytest.raises(FileNotFoundError, match=r"no speech encoder.*task\.speech_encoder=DIR"):
        run("ats", CONFIGS / "ats_paper.yaml", unnamed, corpus, tmp_path)
