"""Training of a parametric head: stages, samples, resuming, what it leaves."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.corpus.heads import head_model
from freetalk.data import open_dataset
from freetalk.head import ParametricHead
from freetalk.train import load_config, run
from freetalk.train.head import HeadTask

CONFIG = Path(__file__).parents[2] / "configs" / "head_smoke.yaml"
QUICK = ["loop.threads=1", "loop.device=cpu"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_mini_corpus(tmp_path_factory.mktemp("head") / "corpus")
    manifest = json.loads((folder / "manifest.json").read_text())
    names = manifest["expressions"]  # as the built-in face has them
    manifest["expressions"] = [n + "_L" if n in ("browInnerUp", "cheekPuff") else n for n in names]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def task(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> HeadTask:
    config = load_config("head", CONFIG, QUICK)
    torch.manual_seed(0)
    return HeadTask(
        config, open_dataset(corpus), tmp_path_factory.mktemp("out"), torch.device("cpu")
    )


def batch(task: HeadTask, step: int, **changed: Any) -> dict[str, Any]:
    rng = np.random.default_rng(step)
    items = [task.item(rng, step * task.batch_size + index) for index in range(task.batch_size)]
    return {**task.collate(items), **changed}


def trained_parts(task: HeadTask, step: int, **changed: Any) -> set[str]:
    """First names of the parameters that a step's loss reaches."""
    task.model.zero_grad(set_to_none=True)
    terms = task.loss(batch(task, step, **changed), torch.Generator())
    terms["loss"].backward()
    return {
        name.split(".")[0]
        for name, parameter in task.model.named_parameters()
        if parameter.grad is not None and parameter.grad.abs().max() > 0
    }


def test_training_leaves_a_head(corpus: Path, tmp_path: Path) -> None:
    seldom = ["loop.log_every=100", "loop.validate_every=100"]  # stages change in between
    result = run("head", CONFIG, [*QUICK, *seldom], corpus, tmp_path)
    assert result.status == "finished"
    assert set(result.scores) == {"identity_mm", "backward_mm", "forward_mm", "score"}
    assert all(np.isfinite(value) and value > 0 for value in result.scores.values())
    head = ParametricHead.from_pretrained(tmp_path / "head")
    rig = head_model()
    state = head.state_dict()
    mean = rig.vertices(np.zeros(100), rig.canonical_weights)[rig.anchors]
    assert np.allclose(state["identity.anchors"].numpy(), mean * 4, atol=1e-6)
    assert state["canonical_weights"][rig.expression_names.index("jawOpen")] == 0.25
    canonical = head.expression_code(torch.from_numpy(rig.canonical_weights)[None])
    assert canonical.abs().max() == 0 and state["rest_expression"].abs().max() > 0
    assert state["identity_scale"].min() > 0
    about = json.loads((tmp_path / "head" / "config.json").read_text())
    assert about["training"]["steps"] == 6


def test_a_stopped_training_goes_on_as_if_it_had_not(corpus: Path, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    run("head", CONFIG, [*QUICK, "loop.checkpoint_every=3"], corpus, whole)
    from freetalk.train import loop

    class Stopped(Exception):
        pass

    def stop(self: Any, draws: Any) -> None:
        if self.step == 3:
            raise Stopped
        step(self, draws)

    step = loop.Trainer._train_step
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop.Trainer, "_train_step", stop)
        with pytest.raises(Stopped):
            run("head", CONFIG, [*QUICK, "loop.checkpoint_every=3"], corpus, parts)
    run("head", CONFIG, [*QUICK, "loop.checkpoint_every=3"], corpus, parts)
    one, other = (
        ParametricHead.from_pretrained(out / "head").state_dict() for out in (whole, parts)
    )
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_stages_train_their_own_parts(task: HeadTask) -> None:
    identity = {"identity", "identity_map"}
    moves = {"deformation_backward", "deformation_forward", "expression_map"}
    assert trained_parts(task, 0) == identity
    assert trained_parts(task, 0, gradients=True) == identity
    assert trained_parts(task, 3) == moves
    assert trained_parts(task, 5) == identity | moves


def test_the_last_part_of_the_first_stage_looks_at_gradients(task: HeadTask) -> None:
    assert not batch(task, 0)["gradients"] and batch(task, 2)["stage"] == "identity"
    terms = task.loss(batch(task, 0, gradients=True), torch.Generator())
    assert {"distance", "normals", "eikonal"} <= set(terms)
    assert "eikonal" not in task.loss(batch(task, 0), torch.Generator())


def test_an_item_depends_on_its_number_alone(task: HeadTask) -> None:
    def item(number: int) -> dict[str, Any]:
        return task.item(np.random.default_rng(number), number)

    first = item(1)
    for number in (0, 9, 7, 30):
        item(number)
    again = item(1)
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["coefficients"], item(25)["coefficients"])


def test_samples_are_distances_in_head_units(task: HeadTask) -> None:
    seen = batch(task, 5)
    assert set(seen) >= {"surface", "normals", "points", "distances", "canonical", "posed"}
    assert seen["points"].abs().max() < 1.0  # a head of 30 cm times 4
    inside = (seen["distances"] < 0).float().mean()
    assert 0.2 < inside < 0.8
    assert torch.allclose(seen["normals"].norm(dim=-1), torch.ones(2, 64), atol=1e-4)


def test_the_field_learns_distances(task: HeadTask) -> None:
    one = batch(task, 0)
    optimizer = torch.optim.Adam(task.model.parameters(), lr=3e-3)
    errors = []
    for _ in range(60):
        terms = task.loss(one, torch.Generator())
        optimizer.zero_grad()
        terms["loss"].backward()
        optimizer.step()
        errors.append(float(terms["distance"]))
    assert errors[-1] < 0.5 * errors[0]


def test_another_corpus_is_refused(corpus: Path, tmp_path: Path) -> None:
    manifest = json.loads((corpus / "manifest.json").read_text())
    other = tmp_path / "other"
    other.mkdir()
    for path in corpus.iterdir():
        (other / path.name).symlink_to(path)
    (other / "manifest.json").unlink()
    manifest["expressions"] = [f"own{n}" for n in range(len(manifest["expressions"]))]
    (other / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match="freetalk corpus build"):
        run("head", CONFIG, QUICK, other, tmp_path / "out")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("task.mixtures=2", "mixtures must be in"),
        ("task.identity_share=0.9", "at most 1 together"),
        ("task.validation_identities=33", "validation_identities"),
        ("task.clamp_m=0", "clamp_m must be positive"),
    ],
)
def test_bad_options_are_refused(override: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_config("head", CONFIG, [override, "task.deformation_share=0.3"])
