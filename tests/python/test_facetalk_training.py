"""FaceTalk's training: targets by name, amplitudes about the face at rest, weights that speak."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from mini_corpus import EXPRESSIONS, write_mini_corpus

from freetalk.data import DatasetError, NotFiniteError, lip_opening, open_dataset, write_codes
from freetalk.facetalk import FaceTalk, generate
from freetalk.train import load_config, run
from freetalk.train.facetalk import FaceTalkTask

CONFIGS = Path(__file__).parents[2] / "configs"
SMOKE = CONFIGS / "facetalk_smoke.yaml"
QUICK = ["loop.threads=1", "loop.device=cpu"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("facetalk") / "corpus")


@pytest.fixture(scope="module")
def coded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A corpus with codes of a head: its weights, turned and shifted."""
    path = write_mini_corpus(tmp_path_factory.mktemp("facetalk") / "coded")
    rng = np.random.default_rng(0)
    weights = np.load(path / "motion.npy")
    turned = weights @ rng.normal(size=(weights.shape[1], 9)).astype(np.float32) + 0.5
    write_codes(path, turned, head="abc", rest=np.full(9, 0.5, np.float32))
    return path


def task(corpus: Path, out: Path, *overrides: str) -> FaceTalkTask:
    config = load_config("facetalk", SMOKE, [*QUICK, *overrides])
    return FaceTalkTask(config, open_dataset(corpus), out, torch.device("cpu"))


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> str:
    """One cache of speech features for all tasks."""
    return f"task.feature_cache={tmp_path_factory.mktemp('features')}"


def test_training_writes_weights_that_speak(corpus: Path, tmp_path: Path, shared: str) -> None:
    result = run("facetalk", SMOKE, [*QUICK, shared], corpus, tmp_path)
    assert result.status == "finished" and np.isfinite(result.scores["loss"])
    assert {"sampled_lve_mm2", "sampled_opening_correlation"} <= result.scores.keys()
    model = FaceTalk.from_pretrained(tmp_path / "facetalk")
    assert model.options.codes == "weights" and list(model.options.expressions) == EXPRESSIONS
    assert model.options.fps == 24.0 and result.directory == tmp_path / "facetalk"
    codes = generate(model, torch.zeros(30, model.options.audio_dim))
    assert codes.shape == (30, len(EXPRESSIONS)) and bool(codes.isfinite().all())


def test_landmarks_of_weights_are_those_of_the_data(
    corpus: Path, tmp_path: Path, shared: str
) -> None:
    own = task(corpus, tmp_path, shared)
    sequence = own.held_out[0]
    codes = torch.from_numpy(own.windows.motion(sequence, 0, None))
    true = torch.from_numpy(own.corpus.landmarks(sequence))
    # A ridge of 1e-6 of the mean variance, landmarks of millimetres.
    torch.testing.assert_close(own.model.landmarks(codes), true, atol=2e-5, rtol=1e-3)


def test_amplitudes_change_about_the_face_at_rest(coded: Path, tmp_path: Path) -> None:
    named = ["task.targets=head", "model.condition=landmarks"]
    own = task(coded, tmp_path, *named, "task.amplitude_low=0.5", "task.amplitude_high=1.5")
    assert own.model_options.head == "abc" and own.model_options.audio_dim == 204
    sequence = own.sampler.sequences[0]
    ratios = []
    for seed in range(8):
        plain = own.windows.cut(sequence, np.random.default_rng(seed), 3, altered=False)["motion"]
        changed = own.windows.cut(sequence, np.random.default_rng(seed), 3)["motion"]
        ratio = (changed - 0.5) / (plain - 0.5)
        np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-3)
        ratios.append(float(ratio[0, 0]))
    assert 0.5 <= min(ratios) < 0.9 and 1.1 < max(ratios) <= 1.5


def test_codes_of_a_head_train_from_landmarks(coded: Path, tmp_path: Path) -> None:
    overrides = [*QUICK, "task.targets=head", "model.condition=landmarks"]
    run("facetalk", SMOKE, overrides, coded, tmp_path)
    model = FaceTalk.from_pretrained(tmp_path / "facetalk")
    assert model.options.codes == "head" and model.options.code_dim == 9
    assert model.get_buffer("rest_code").tolist() == [0.5] * 9


def test_losses_are_those_that_are_asked_for(corpus: Path, tmp_path: Path, shared: str) -> None:
    own = task(corpus, tmp_path, shared, "task.loss_units=codes", "task.opening_weight=0",
               "task.closure_weight=0", "model.dropout=0")  # fmt: skip
    batch = own.collate([own.item(np.random.default_rng(seed), seed) for seed in range(4)])
    terms = own.loss(batch, torch.Generator())
    assert set(terms) == {"loss", "position", "velocity"}
    clean = own.model.normalize(batch["codes"]) * batch["valid"][..., None]
    noisy = own.schedule.q_sample(clean, batch["step"], noise=batch["noise"])
    guess = own.model(noisy, batch["step"], audio=batch["audio"], drop_audio=batch["drop_audio"])
    error = (own.model.denormalize(guess) - batch["codes"]).square().mean(-1)
    torch.testing.assert_close(terms["loss"], error[batch["valid"]].mean())  # Eq. 4
    extra = task(corpus, tmp_path, shared)
    assert {"opening", "closure"} <= extra.loss(batch, torch.Generator()).keys()


def test_without_diffusion_the_noise_does_not_matter(
    corpus: Path, tmp_path: Path, shared: str
) -> None:
    own = task(corpus, tmp_path, shared, "model.diffusion=false")
    own.model.eval()
    batch = own.collate([own.item(np.random.default_rng(seed), seed) for seed in range(4)])
    one = own.loss(batch, torch.Generator())["loss"]
    other = own.loss({**batch, "noise": batch["noise"] + 1}, torch.Generator())["loss"]
    assert torch.equal(one, other)


def test_missing_or_broken_codes_are_named(corpus: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="freetalk corpus codes"):
        task(corpus, tmp_path, "task.targets=head")
    with pytest.raises(ValueError, match="must be one of weights, head"):
        task(corpus, tmp_path, "task.targets=heads")
    with pytest.raises(ValueError, match="amplitude_low"):
        task(corpus, tmp_path, "task.amplitude_low=2")
    frames = len(np.load(corpus / "landmarks.npy", mmap_mode="r"))
    codes = np.zeros((frames, 3), np.float32)
    with pytest.raises(DatasetError, match="expected codes"):
        write_codes(corpus, codes[1:], "abc", codes[0])
    codes[7, 1] = np.nan
    with pytest.raises(NotFiniteError, match="frame 7"):
        write_codes(corpus, codes, "abc", np.zeros(3, np.float32))
    assert not (corpus / "codes.npy").exists()


def test_opening_is_that_of_the_library(corpus: Path, tmp_path: Path, shared: str) -> None:
    own = task(corpus, tmp_path, shared)
    sequence = own.held_out[0]
    record: dict[str, Any] = own._sampled(sequence, seed=1)
    true = lip_opening(own.corpus.landmarks(sequence))
    np.testing.assert_allclose(record["openings"][1], true[: len(record["openings"][1])])


def test_weights_are_measured_and_assembled(corpus: Path, tmp_path: Path, shared: str) -> None:
    from freetalk.evaluate import weights as scores_of

    run("facetalk", SMOKE, [*QUICK, shared, "loop.max_steps=1"], corpus, tmp_path)
    assert (tmp_path / "speech/model.safetensors").is_file()  # that of the training
    scores = scores_of.measure(
        open_dataset(corpus), tmp_path, parts=["facetalk"], samples=2, steps=2
    )
    assert {"single_sample", "mean_of_2"} <= scores["facetalk opening"].keys()
    assert scores["facetalk closures"]["phones"] > 0
    with pytest.raises(ValueError, match="known: stm, ats, emotions, facetalk"):
        scores_of.measure(open_dataset(corpus), tmp_path, parts=["face"])
