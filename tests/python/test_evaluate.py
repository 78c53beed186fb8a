"""Scores: closed forms, and one pass over a small corpus."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mini_corpus import write_mini_corpus

from freetalk.cli import main
from freetalk.evaluate import NearestCentroid, closures, correlation, log_energy
from freetalk.evaluate.pretrained import SpeechToMotion
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


def test_all_scores_of_a_small_corpus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "operators"))
    corpus = write_mini_corpus(tmp_path / "corpus")
    for kind in ("speech", "ats", "stm"):
        overrides = ["loop.max_steps=1", "loop.threads=1", "loop.device=cpu"]
        if kind == "ats":
            overrides.append("task.speech_encoder=")  # the one trained before it
        run(kind, CONFIGS / f"{kind}_smoke.yaml", overrides, corpus, tmp_path / "out")
    take = "facegood_test"
    given = f"evaluate --data {corpus} --pretrained {tmp_path / 'out'} --take {take}"
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
    (tmp_path / "out" / "talker.json").write_text(json.dumps({"generate": {"num_steps": 7}}))
    assert SpeechToMotion.of(tmp_path / "out").options.num_steps == 7  # as the weights want it
    assert SpeechToMotion.of(tmp_path / "out", 3).options.num_steps == 3
