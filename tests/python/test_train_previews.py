"""Samples of a training: drawn on held-out data, shown beside the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import open_dataset
from freetalk.train import load_config, run
from freetalk.train.previews import MeanFace, Sample, save_sample
from freetalk.train.run import make_task
from freetalk.train.stm import StmTask

CONFIGS = Path(__file__).parents[2] / "configs"
QUICK = ["loop.threads=1", "loop.device=cpu"]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("samples") / "corpus")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path_factory.getbasetemp() / "operators"))


def test_a_sample_is_shown_beside_the_truth(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(-0.07, 0.07, 5), np.linspace(-0.09, 0.09, 5))
    vertices = np.stack([x, y, 0.04 - 4 * x**2], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    faces = np.stack([corner, corner + 1, corner + 6], axis=1)
    moving = np.linspace(0, 0.03, 4, dtype=np.float32)[:, None, None] * np.ones_like(vertices)
    sound = np.zeros(16000 * 4 // 25, np.float32)
    sample = Sample(vertices, faces, moving, np.zeros_like(moving), 25.0, sound)
    picture = save_sample(sample, tmp_path / "below" / "step_1")
    predicted, true = np.split(picture, 2)
    assert predicted.shape == true.shape == (360, 6 * 360, 3)
    first, last = slice(0, 360), slice(5 * 360, None)
    np.testing.assert_array_equal(predicted[:, first], true[:, first])
    assert (predicted[:, last] != true[:, last]).any()
    np.testing.assert_array_equal(true[:, first], true[:, last])
    assert (tmp_path / "below" / "step_1.mp4").stat().st_size > 1000


def test_a_landmark_network_shows_a_held_out_face(corpus: Path, tmp_path: Path) -> None:
    config = load_config("stm", CONFIGS / "stm_smoke.yaml", QUICK)
    task = make_task(config, open_dataset(corpus), tmp_path, torch.device("cpu"))
    assert isinstance(task, StmTask)
    with torch.no_grad():
        sample = task.sample()
    assert len(sample.vertices) == 100  # the meshing of the val split
    assert sample.predicted.shape == sample.true.shape == (len(sample.true), 100, 3)
    assert np.isfinite(sample.predicted).all() and np.abs(sample.true).max() > 1e-3
    assert len(sample.audio) == round(len(sample.true) / sample.fps * sample.sample_rate_hz)


def test_landmarks_move_the_mean_face(tmp_path: Path) -> None:
    face = MeanFace(tmp_path / "no weights", torch.device("cpu"))
    landmarks = torch.zeros(2, 68, 3)
    landmarks[1, 48:68, 1] = -0.004
    motion = face.moved(landmarks)
    assert motion.shape == (2, len(face.vertices), 3)
    # The shipped network keeps still to a fraction of a millimetre.
    assert np.linalg.norm(motion[0], axis=-1).mean() < 5e-4
    assert motion[1, :, 1].min() < motion[0, :, 1].min() - 5e-4


def test_a_training_writes_a_video_when_it_is_due(
    corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("freetalk.train.stm._SAMPLE_FRAMES", 3)
    options = [*QUICK, "loop.max_steps=3", "loop.render_every=2", "loop.validate_every=0"]
    run("stm", CONFIGS / "stm_smoke.yaml", options, corpus, tmp_path)
    assert [p.name for p in (tmp_path / "samples" / "stm").iterdir()] == ["step_0000002.mp4"]
