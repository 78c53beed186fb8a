"""Scores: closed forms, and one pass over a small corpus."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from dataset_layouts import packed, write_folder
from mini_corpus import write_mini_corpus

from freetalk.ats import Ats, AtsOptions, GenerateOptions, generate, generate_batch
from freetalk.cli import main
from freetalk.data import Dataset, MotionSequence, open_dataset
from freetalk.data.pose import METRES
from freetalk.evaluate import NearestCentroid, closures, correlation, log_energy
from freetalk.evaluate.dataset_truth import DatasetTruth
from freetalk.evaluate.motion_files import read_motion
from freetalk.evaluate.predict import PredictOptions, predict
from freetalk.evaluate.pretrained import LandmarksToMesh, SpeechToMotion
from freetalk.evaluate.recorded import evaluate_recorded
from freetalk.evaluate.weights import measure
from freetalk.train import run

CONFIGS = Path(__file__).parents[2] / "configs"


def opened(values: list[float]) -> np.ndarray:
    landmarks = np.zeros((len(values), 68, 3), dtype=np.float32)
    landmarks[:, 62, 1] = values
    return landmarks


def test_closures_look_at_the_phone_alone() -> None:
    landmarks = opened([0.010, 0.001, 0.010, 0.002, 0.010, 0.010])
    # At 1 fps frame i is second i; 15 % of 10 mm is 1.5 mm.
    phones = [(1.0, 2.0, "P"), (2.0, 3.0, "AA"), (3.0, 4.0, "M"), (4.0, 5.0, "B")]
    assert closures(landmarks, phones, 1.0) == [True, False, False]
    assert closures(landmarks, phones, 1.0, share=0.25) == [True, True, False]


def test_correlation_of_constant_series_is_zero() -> None:
    ramp = np.arange(5, dtype=np.float32)
    assert correlation(ramp, 3 * ramp + 1) == pytest.approx(1.0)
    assert correlation(ramp, np.ones(5, dtype=np.float32)) == 0.0


def test_log_energy_follows_the_loudness() -> None:
    wave = np.concatenate([np.full(8000, 0.01), np.full(8000, 0.1)]).astype(np.float32)
    energy = log_energy(wave, 30, 30.0, 16000)
    # Ten times the amplitude is log(100) in energy.
    assert energy[25] - energy[5] == pytest.approx(np.log(100), rel=1e-3)


def test_nearest_centroid_finds_separate_classes() -> None:
    rng = np.random.default_rng(0)
    features = np.concatenate([rng.normal(c, 0.1, (20, 4)) for c in (0.0, 1.0)])
    classifier = NearestCentroid(features, ["a"] * 20 + ["b"] * 20)
    assert [classifier.label(np.full(4, v)) for v in (0.1, 0.9)] == ["a", "b"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("evaluate") / "corpus")


@pytest.fixture(scope="module")
def weights(corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All stages of one step, on the corpus."""
    out = tmp_path_factory.mktemp("weights")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FREETALK_CACHE", str(out / "operators"))
        for kind in ("speech", "ats", "stm"):
            overrides = ["loop.max_steps=1", "loop.threads=1", "loop.device=cpu"]
            if kind == "ats":
                overrides.append("task.speech_encoder=")  # the one trained before it
            run(kind, CONFIGS / f"{kind}_smoke.yaml", overrides, corpus, out)
    return out


@pytest.mark.usefixtures("own_cache")
def test_all_scores_of_a_small_corpus(
    corpus: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    take = "facegood_test"
    given = f"evaluate --data {corpus} --pretrained {weights} --take {take} --device cpu"
    given += " --samples 2 --steps 2"
    assert main([*given.split(), "--out", str(tmp_path / "scores.json")]) == 0
    scores = json.loads((tmp_path / "scores.json").read_text())
    assert scores["stm"]["topologies"].keys() == {"finest"}
    assert scores["stm"]["relative_error"] > 0
    assert -1 <= scores["opening"]["single_sample"] <= 1
    assert scores["closures"]["phones"] == 1
    assert 0 <= scores["emotions"]["recognised"] <= 1
    assert "relative_lip_error" in capsys.readouterr().out
    assert main([*given.replace(take, "other").split(), "--parts", "ats"]) == 2
    assert "no neutral test sequence of take 'other'" in capsys.readouterr().err


@pytest.mark.usefixtures("own_cache")
def test_weights_are_scored_on_any_dataset(weights: Path, tmp_path: Path) -> None:
    own = packed(write_folder(tmp_path / "own", frames=50, fps=25))
    scores = measure(open_dataset(own), weights, samples=2, steps=2, device="cpu")
    assert scores.keys() == {"stm", "opening", "emotions"}  # no phones are known
    assert scores["stm"]["relative_error"] > 0 and scores["opening"]["frames"] >= 50


def test_weights_are_sampled_as_they_want_it(weights: Path, tmp_path: Path) -> None:
    for stage in ("speech", "ats"):
        shutil.copytree(weights / stage, tmp_path / stage)
    (tmp_path / "talker.json").write_text(json.dumps({"generate": {"num_steps": 7}}))
    assert SpeechToMotion.of(tmp_path).options.num_steps == 7
    assert SpeechToMotion.of(tmp_path, {"num_steps": 3}).options.num_steps == 3


# Predictions


@pytest.mark.usefixtures("own_cache")
def test_predictions_of_true_landmarks_score_as_the_network_does(
    corpus: Path, weights: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    given = f"predict --data {corpus} --pretrained {weights} --driver landmarks --device cpu"
    assert main([*given.split(), "--out", str(out)]) == 0
    dataset = open_dataset(corpus)
    clip = dataset.sequences("test")[0]
    mesh = LandmarksToMesh(weights / "stm", "cpu")
    expected = mesh.vertices(dataset, clip.identity, "finest", dataset.landmarks(clip)).numpy()
    with np.load(out / f"{clip.id}.npz") as found:
        np.testing.assert_array_equal(found["displacements"], expected)
        assert (found["fps"], found["metres_per_unit"]) == (30, 1)
    scored = (
        f"evaluate --pred {out} --gt {corpus} --metrics mve_mean --out {tmp_path / 'scores.json'}"
    )
    assert main(scored.split()) == 0
    (row,) = json.loads((tmp_path / "scores.json").read_text())["metrics"]
    error = np.linalg.norm(expected - dataset.vertex_displacements("finest", clip), axis=-1)
    value = row["systems"]["out"]["per_sequence"][clip.id]
    assert value == pytest.approx(1000 * error.mean(), rel=1e-4)


@pytest.mark.usefixtures("own_cache")
def test_a_stopped_prediction_goes_on_and_another_one_is_refused(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = packed(write_folder(tmp_path / "own", frames=50, fps=25))
    out = tmp_path / "out"
    given = f"predict --data {own} --pretrained {weights} --samples 2 --steps 2 --device cpu"
    command = [*given.split(), "--out", str(out)]
    assert main(command) == 0
    files = sorted(out.glob("*.npz"))
    clips = [clip.id for clip in open_dataset(own).sequences("test")]
    assert [f.stem for f in files] == sorted(f"{c}_sample{k}" for c in clips for k in (0, 1))
    content = {file: np.load(file)["displacements"] for file in files}
    assert not np.array_equal(content[files[0]], content[files[1]])
    files[0].unlink()
    assert main(command) == 0
    for file in files:
        np.testing.assert_array_equal(np.load(file)["displacements"], content[file])
    assert main([*command, "--seed", "5"]) == 2
    assert "holds another prediction" in capsys.readouterr().err
    scored = f"evaluate --pred {out} --gt {own} --metrics mve_mean diversity_vertex"
    assert main(scored.split()) == 0


@pytest.mark.usefixtures("own_cache")
def test_predictions_lie_in_the_axes_of_the_datasets_files(
    weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = open_dataset(packed(write_folder(tmp_path / "own", frames=50, fps=25)))
    turned = replace(METRES, rotation=np.eye(3, dtype=np.float32)[[1, 2, 0]])
    monkeypatch.setattr(Dataset, "source_frame", lambda *_: (turned, np.zeros(3, np.float32)))
    options = PredictOptions(driver="landmarks")
    predict(dataset, weights, tmp_path / "out", options, device="cpu")
    truth = DatasetTruth(dataset, "test", None)
    for clip in dataset.sequences("test"):
        file = read_motion(tmp_path / "out" / f"{clip.id}.npz")
        mesh = LandmarksToMesh(weights / "stm", "cpu")
        wanted = mesh.vertices(
            dataset, clip.identity, str(clip.topology), dataset.landmarks(clip)
        ).numpy()
        placed = truth.place(file, clip.id, "auto", None)
        np.testing.assert_allclose(placed, wanted, atol=1e-7)


def test_what_a_prediction_lacks_is_named(
    corpus: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(weights / "stm", tmp_path / "half" / "stm")
    given = f"predict --data {corpus} --pretrained {tmp_path / 'half'} --out {tmp_path / 'out'}"
    assert main(given.split()) == 2
    assert "lacks speech and ats" in capsys.readouterr().err
    assert main([*given.split(), "--driver", "landmarks", "--split", "train"]) == 2
    assert "has the meshings coarse, fine in its split 'train'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_clips_that_are_sampled_together_move_as_alone() -> None:
    options = AtsOptions(d_model=32, num_layers=1, num_heads=2, ff_dim=64, max_frames=20)
    options.audio_dim = 8
    torch.manual_seed(0)
    model = Ats(options).eval()
    for parameter in model.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    features = [torch.randn(frames, 8) for frames in (20, 13, 31)]  # the last takes two windows
    emotion = torch.eye(len(options.emotions))[[0, 3, 5]]
    intensity = torch.tensor([1.0, 2.5, 3.0])
    how = {"num_steps": 4, "mouth_temperature": 0.5}
    how |= {"audio_guidance": 1.5, "affect_guidance": 1.3}
    for sampler in ("dpmpp", "ddim", "ddpm"):
        o = GenerateOptions(sampler=sampler, **how)
        seeds = [[1, 2], [3, 4], [5, 6]]
        together = generate_batch(
            model, features, emotion=emotion, intensity=intensity, options=o, seeds=seeds
        )
        for k, moved in enumerate(together):
            alone = generate(
                model, features[k], emotion=emotion[k], intensity=intensity[k], options=o,
                seed=seeds[k],
            )  # fmt: skip
            assert moved.shape == alone.shape and moved.std() > 0
            # Sums over the batch are taken in another order.
            torch.testing.assert_close(
                moved, alone, rtol=1e-4, atol=1e-5 * float(alone.abs().max())
            )


class _Repeats:
    """Performs what was recorded, `late` frames late and `gain` times as large."""

    def __init__(self, late: int = 0, gain: float = 1.0) -> None:
        self.late, self.gain = late, gain

    def perform(
        self, dataset: Dataset, clips: list[MotionSequence], seeds: list[list[int]]
    ) -> Iterator[tuple[MotionSequence, np.ndarray]]:
        for clip, own in zip(clips, seeds, strict=True):
            motion = self.gain * np.roll(dataset.landmarks(clip), self.late, axis=0)
            yield clip, np.stack([motion] * len(own))


def test_recorded_motion_scores_best_and_lateness_and_size_are_told(corpus: Path) -> None:
    dataset = open_dataset(corpus)
    same = evaluate_recorded(dataset, _Repeats())  # type: ignore[arg-type]
    assert same["opening"]["correlation"] > 0.999 and same["width"]["clips"] > 0.999
    assert same["opening"]["lag"] == 0 and same["opening"]["spread"] == pytest.approx(1.0)
    assert same["closures"] == 0 or same["closed"] == 1.0
    late = evaluate_recorded(dataset, _Repeats(late=2, gain=0.5))  # type: ignore[arg-type]
    assert late["opening"]["lag"] == 2 and late["opening"]["spread"] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="no sequence with sound"):
        evaluate_recorded(dataset, _Repeats(), "nothing")  # type: ignore[arg-type]
