"""What the denoiser is shown in training: which diffusion steps, and whose motion under the noise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import Dataset, open_dataset
from freetalk.data.landmarks import EYES, LIPS, UPPER_FACE
from freetalk.train.ats import AtsTask
from freetalk.train.config import load_config

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return open_dataset(write_mini_corpus(tmp_path_factory.mktemp("steps") / "corpus"))


def make(corpus: Dataset, out: Path, *overrides: str) -> AtsTask:
    config = load_config("ats", CONFIGS / "ats_smoke.yaml", list(overrides))
    return AtsTask(config, corpus, out, torch.device("cpu"))


@pytest.mark.parametrize(("power", "mean"), [(1.0, 0.5), (3.0, 0.75)])
def test_the_power_dwells_on_noisy_steps(
    corpus: Dataset, tmp_path: Path, power: float, mean: float
) -> None:
    task = make(corpus, tmp_path, f"task.step_power={power}")
    rng = np.random.default_rng(0)
    steps = np.array([task.item(rng, number)["step"] for number in range(600)])
    assert steps.min() >= 0 and steps.max() < 1000
    assert steps.mean() / 1000 == pytest.approx(mean, abs=0.04)


class Spy:
    """A schedule that keeps what it was asked to add noise to."""

    def __init__(self, schedule: Any) -> None:
        self.schedule = schedule
        self.clean: list[torch.Tensor] = []

    def q_sample(self, clean: torch.Tensor, step: torch.Tensor, noise: torch.Tensor) -> Any:
        self.clean.append(clean)
        return self.schedule.q_sample(clean, step, noise=noise)


@pytest.mark.parametrize("rehearsal", [0.0, 1.0])
def test_a_rehearsed_mouth_is_the_models_own_estimate(
    corpus: Dataset, tmp_path: Path, rehearsal: float
) -> None:
    task = make(corpus, tmp_path, f"task.rehearsal={rehearsal}", "model.dropout=0")
    rng = np.random.default_rng(1)
    batch = task.collate([task.item(rng, number) for number in range(3)])
    spy = Spy(task.schedule)
    task.schedule = spy  # type: ignore[assignment]
    task.loss(batch, torch.Generator())["loss"].backward()
    true = ((batch["motion"] - task.mean) / task.spread * batch["valid"][..., None]).unflatten(
        -1, (68, 3)
    )
    shown = spy.clean[0].unflatten(-1, (68, 3))
    same = torch.isclose(shown, true).all(dim=-1).all(dim=0).all(dim=0)  # (68,)
    upper = torch.zeros(68, dtype=torch.bool)
    upper[list(UPPER_FACE)] = True
    torch.testing.assert_close(same, upper if rehearsal else torch.ones_like(upper))
    assert not shown.requires_grad  # what was rehearsed is given, not learnt through
    assert (shown[~batch["valid"]] == 0).all()


def test_a_known_prefix_is_given_clean_and_not_judged(corpus: Dataset, tmp_path: Path) -> None:
    task = make(corpus, tmp_path, "task.known_prefix=1", "model.dropout=0", "task.rehearsal=0.5")
    assert task.model.options.known_prefix
    items = [task.item(np.random.default_rng(seed), seed) for seed in range(8)]
    fresh = [len(item["motion"]) - item["known"] for item in items]
    assert min(fresh) > 0 and max(fresh) <= 24 and len({item["known"] for item in items}) > 3
    batch = task.collate([item for item in items if item["known"] > 2][:3])
    shown = []
    task.model.register_forward_pre_hook(
        lambda _, args, named: shown.append((args[0], named["known"])), with_kwargs=True
    )
    terms = task.loss(batch, torch.Generator())
    clean = (batch["motion"] - task.mean) / task.spread
    true = [row for row in range(3) if row not in batch["rehearsed"].tolist()]
    x, known = shown[-1]
    for row in true:
        torch.testing.assert_close(x[row, : known[row]], clean[row, : known[row]])
        assert not torch.isclose(x[row, known[row] :], clean[row, known[row] :]).all(dim=1).any()
    assert torch.equal(known, batch["known"])
    batch["known"] = batch["valid"].sum(dim=1)  # nothing is left to be found
    assert terms["position"].item() > 0
    assert task.loss(batch, torch.Generator())["position"].item() == 0


@pytest.mark.parametrize("weighted, others", [(EYES, LIPS), (LIPS, EYES)])
def test_eyes_and_lips_weigh_as_asked(
    corpus: Dataset, tmp_path: Path, weighted: tuple[int, ...], others: tuple[int, ...]
) -> None:
    eyes, lips = (3.0 if part is weighted else 1.0 for part in (EYES, LIPS))
    task = make(corpus, tmp_path, f"task.eye_weight={eyes}", f"task.lip_weight={lips}")
    rng = np.random.default_rng(2)
    batch = task.collate([task.item(rng, number) for number in range(2)])
    target = task._normalised(batch).view(*batch["motion"].shape[:2], -1, 3)
    losses = []
    for part in (weighted, others):
        off = target.clone()
        off[..., list(part), :] += 1.0
        task._denoise = lambda *_, off=off: off.flatten(-2)  # type: ignore[method-assign]
        terms = task._terms(batch, batch["step"], batch["noise"])
        losses.append(float(terms["position"]) / len(part))
    assert losses[0] / losses[1] == pytest.approx(3.0, rel=1e-4)
