"""Training faces with other sculpts: landmarks tell what the changed motion does, and the face keeps its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import Dataset, open_dataset
from freetalk.train.stm_cuts import FaceCuts
from freetalk.train.stm_landmarks import FaceLandmarks
from freetalk.train.stm_meshes import prepare_mesh
from freetalk.train.stm_sculpts import Bend, RandomField, Sculpts
from freetalk.train.stm_windows import FaceWindows


@pytest.fixture
def corpus(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Dataset:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    return open_dataset(write_mini_corpus(tmp_path / "corpus"))


def test_a_random_field_is_smooth_and_of_size_one() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.1, 0.1, (2000, 3))
    values = np.stack([RandomField(rng, 3)(points) for _ in range(30)])
    assert values.std() == pytest.approx(1.0, abs=0.15)
    field = RandomField(rng, 1)
    assert np.abs(field(points + 1e-4) - field(points)).max() < 0.1


def test_a_bend_keeps_place_and_size() -> None:
    rng = np.random.default_rng(1)
    marks = rng.normal(0, 0.04, (68, 3))
    marks -= marks.mean(axis=0)
    bend = Bend(rng, marks)
    bent = bend(marks)
    assert np.abs(bent.mean(axis=0)).max() < 1e-9
    assert bent.var(axis=0).sum() == pytest.approx(marks.var(axis=0).sum())
    assert np.abs(bent - marks).max() > 0.003
    still = np.zeros((2, 68, 3))
    assert np.abs(bend.motion(marks, still)).max() == 0


def test_landmarks_tell_what_a_sculpt_does(corpus: Dataset) -> None:
    landmarks = FaceLandmarks(corpus)
    sculpts = Sculpts(corpus, landmarks)
    topology, mesh = "fine", corpus.mesh(corpus.identities("train")[0], "fine")
    weights = np.zeros((3, len(corpus.expressions)), np.float32)
    weights[1, 0], weights[2, 2] = 1.0, 0.5
    places = landmarks.on(topology, mesh)
    _, _, basis = corpus.drawn() or pytest.fail("the corpus has no expressions")
    own = corpus.displacements_of(topology, weights)
    missed = np.tensordot(weights, basis, axes=1) - places.of(own)
    seen = []
    for number in range(6):
        marks, moved = sculpts.motion(np.random.default_rng(number), topology, mesh, weights)
        assert np.abs(marks[0]).max() < 1e-9 and np.abs(moved[0]).max() < 1e-9  # no expression
        # What the meshing misses of the true landmarks stays; all the rest is read from the result.
        assert np.allclose(marks, places.of(moved) + missed, atol=1e-7)
        seen.append(moved)
    changes = [np.linalg.norm(moved - own) / np.linalg.norm(own) for moved in seen]
    assert min(changes) > 0.05 and np.std(changes) > 0.02
    again = sculpts.motion(np.random.default_rng(0), topology, mesh, weights)[1]
    assert np.array_equal(again, seen[0])


def test_windows_show_sculpts_and_bent_faces_in_their_shares(corpus: Dataset) -> None:
    landmarks = FaceLandmarks(corpus)
    identity, topology = corpus.faces("train")[0]
    mesh = prepare_mesh(
        corpus, identity, topology, 0.1, 8, cuts=FaceCuts(), landmarks=landmarks, bends=1.0
    )
    bend = mesh.face.bend
    assert bend is not None and mesh.follower is not None
    whole = corpus.mesh(identity, topology)
    assert np.allclose(mesh.positions.numpy(), bend(whole.vertices), atol=1e-6)
    sculpts = Sculpts(corpus, landmarks)
    for share in (0.0, 1.0):
        windows = FaceWindows(corpus, [mesh.face], "train", {}, 4, sculpts, share)
        sequence = windows.sampler.sequences[0]
        window = windows.of(sequence, 0, np.random.default_rng(0), first=2)
        moved = corpus.vertex_displacements(topology, sequence, 2, 6)
        bent = bend.motion(whole.vertices, moved)
        assert np.allclose(window.target, bent, atol=1e-6) == (share == 0.0)
        assert window.landmarks.shape == (4, 68, 3) and window.landmarks.dtype == np.float32


def test_a_corpus_without_expressions_cannot_be_sculpted(
    corpus: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    landmarks = FaceLandmarks(corpus)
    monkeypatch.setattr(Dataset, "drawn", lambda self: None)
    with pytest.raises(ValueError, match="sculpts changes what weights"):
        Sculpts(corpus, landmarks)


def test_a_follower_is_trained_through(corpus: Dataset) -> None:
    identity, topology = corpus.faces("train")[0]
    mesh = prepare_mesh(corpus, identity, topology, 0.1, 8, landmarks=FaceLandmarks(corpus))
    assert mesh.follower is not None
    given = torch.zeros(2, len(mesh.positions), 3, requires_grad=True)
    mesh.follower.apply(given, torch.full((2, 68, 3), 0.001)).sum().backward()
    assert given.grad is not None and torch.isfinite(given.grad).all()
