"""Training faces that lose parts: the rest keeps its place, its motion and its lips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import FaceMesh, open_dataset
from freetalk.train.stm_cuts import FaceCuts
from freetalk.train.stm_meshes import prepare_mesh
from freetalk.train.stm_windows import FaceWindows


def disc(radius_m: float = 0.2, rings: int = 60, spokes: int = 90) -> FaceMesh:
    """A flat disc around the lips, which are its middle."""
    radii = np.linspace(0.002, radius_m, rings)
    angles = np.linspace(0, 2 * np.pi, spokes, endpoint=False)
    r, a = np.meshgrid(radii, angles, indexing="ij")
    vertices = np.stack([r * np.cos(a), r * np.sin(a), 0 * r], -1).reshape(-1, 3)
    ring, spoke = np.meshgrid(np.arange(rings - 1), np.arange(spokes), indexing="ij")
    after = (spoke + 1) % spokes
    corners = [ring * spokes + spoke, ring * spokes + after]
    above = [(ring + 1) * spokes + spoke, (ring + 1) * spokes + after]
    faces = np.concatenate(
        [
            np.stack([corners[0], corners[1], above[1]], -1).reshape(-1, 3),
            np.stack([corners[0], above[1], above[0]], -1).reshape(-1, 3),
        ]
    )
    lips = np.linalg.norm(vertices, axis=1) < 0.02
    return FaceMesh("disc", vertices.astype(np.float32), faces, lips, ~lips)


def test_crops_keep_the_lips_and_end_in_many_places() -> None:
    face = disc()
    reaches = []
    for index in range(30):
        left = FaceCuts(crops=1.0).of(face, index)
        assert left is not None
        kept, faces = left
        assert face.lip_mask[kept].sum() == face.lip_mask.sum()
        assert faces.min() == 0 and faces.max() == len(kept) - 1
        whole = {tuple(triangle) for triangle in face.faces}
        assert all(tuple(triangle) in whole for triangle in kept[faces[:50]])
        reaches.append(np.ptp(face.vertices[kept], axis=0)[:2])
        again = FaceCuts(crops=1.0).of(face, index)
        assert again is not None and np.array_equal(again[0], kept)
    low, high = np.min(reaches, axis=0), np.max(reaches, axis=0)
    assert (low > 0.1).all() and (high < 0.33).all() and (high > 1.3 * low).all()


def test_shares_of_crops_and_of_missing_triangles() -> None:
    face = disc()
    cut = [FaceCuts(crops=0.5).of(face, index) is not None for index in range(200)]
    assert 0.4 < np.mean(cut) < 0.6
    assert all(FaceCuts().of(face, index) is None for index in range(20))
    assert all(FaceCuts(1.0, 0.0, 10**4).of(face, index) is None for index in range(20))
    lost = []
    for index in range(40):
        whole, torn = (FaceCuts(1.0, share).of(face, index) for share in (0.0, 0.2))
        assert whole is not None and torn is not None
        lost.append(1 - len(torn[1]) / len(whole[1]))
    assert 0.06 < np.mean(lost) < 0.14 and max(lost) < 0.22


def test_a_cropped_face_moves_as_the_whole_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    corpus = open_dataset(write_mini_corpus(tmp_path / "corpus"))
    identity, topology = corpus.faces("train")[0]
    whole = corpus.mesh(identity, topology)
    kept = np.arange(3, len(whole.vertices))
    faces = whole.faces[(whole.faces >= 3).all(axis=1)] - 3
    monkeypatch.setattr(FaceCuts, "of", lambda self, mesh, index: (kept, faces))
    mesh = prepare_mesh(corpus, identity, topology, 0.1, 8, cuts=FaceCuts(1.0))
    assert torch.equal(mesh.positions, torch.from_numpy(whole.vertices[kept]))
    assert torch.equal(mesh.lip_mask, torch.from_numpy(whole.lip_mask[kept]))
    windows = FaceWindows(corpus, [mesh.face], "train", {}, 4)
    sequence = windows.first_on(0)
    window = windows.of(sequence, 0, np.random.default_rng(0))
    every = corpus.vertex_displacements(topology, sequence)
    assert any(
        np.array_equal(window.target, every[start : start + 4, kept])
        for start in range(len(every) - 3)
    )
