"""Sequences whose frames are scans, a mesh of its own each: packed as points, trained by distances and landmarks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from dataset_layouts import face, landmark_indices, motion_of, neutral_of, packed, write_ply
from test_train import CONFIGS, QUICK

import freetalk
from freetalk.data import Dataset, DatasetError, open_dataset
from freetalk.data.check import check_dataset
from freetalk.data.triangles import closest_on_triangles
from freetalk.geometry import SurfaceTree, surface_operators
from freetalk.mesh import to_vertex_budget
from freetalk.stm import Stm
from freetalk.train import run
from freetalk.train.stm_scans import chamfer_loss, scan_errors

pytestmark = pytest.mark.usefixtures("own_cache")
SIZE, FRAMES = (400, 760), 12
SPEAKERS = {"ann": "train", "bob": "val", "cleo": "test"}


def moving(neutral: np.ndarray, seed: int) -> np.ndarray:
    """(T, V, 3) positions: the jaw opens, and the forehead, which has no landmark, swells with it."""
    moved = motion_of(neutral, FRAMES, 30, seed)
    opening = (neutral[:, 1] - moved[..., 1]).max(axis=1)
    moved[..., 2] += 2 * opening[:, None] * above(neutral)
    return moved


def above(neutral: np.ndarray) -> np.ndarray:
    """(..., V) how much a vertex belongs to the forehead."""
    return np.exp(-np.square((neutral[..., 1] - 0.085) / 0.02)).astype(np.float32)


def remeshed(vertices: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The same surface in other triangles, of another number each."""
    rng = np.random.default_rng(seed)
    mesh = freetalk.Mesh(vertices.astype(np.float64), face(*SIZE)[1].tolist(), name="frame")
    made = to_vertex_budget(mesh, int(rng.integers(700, 1100)), rng.uniform(0.5, 2, SIZE[0])).mesh
    return np.asarray(made.vertices), np.asarray(made.faces)


def write_scans(folder: Path) -> Path:
    """Speakers whose takes are remeshed frame by frame; the neutral scans have other vertices each."""
    rows, marks = ["name,speaker,split"], landmark_indices(face(*SIZE)[0])
    for name in ("motion", "templates"):
        (folder / name).mkdir(parents=True)
    for seed, (speaker, split) in enumerate(SPEAKERS.items()):
        neutral = neutral_of(speaker, SIZE)
        write_ply(folder / "scans" / f"{speaker}.ply", *remeshed(neutral, seed))
        np.save(folder / "templates" / f"{speaker}.npy", neutral[marks])
        moved = moving(neutral, seed)
        np.save(folder / "motion" / f"{speaker}_1.npy", moved[:, marks])
        rows.append(f"{speaker}_1,{speaker},{split}")
        for number, frame in enumerate(moved):
            scan = remeshed(frame, 100 * seed + number)
            write_ply(folder / "scans" / f"{speaker}_1" / f"{number:04d}.ply", *scan)
    (folder / "labels.csv").write_text("\n".join(rows) + "\n")
    (folder / "dataset.json").write_text(json.dumps({"fps": 30, "unit": "m"}))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scans(tmp_path_factory.mktemp("scans") / "own")


@pytest.fixture(scope="module")
def scans(folder: Path) -> Path:
    return packed(folder)


def test_points_lie_on_the_frames_and_meshings_belong_to_their_speakers(scans: Path) -> None:
    dataset = open_dataset(scans)
    assert check_dataset(scans).errors == []
    (sequence,) = dataset.sequences("val")
    points = dataset.scans(sequence, 3, 5)
    assert points.shape == (2, 8192, 3)
    ((identity, topology),) = dataset.faces("val")
    assert (topology, sequence.topology) == ("bob", "bob")
    mesh = dataset.mesh(identity, topology)
    assert mesh.landmarks is not None and len(mesh.landmarks) == 68
    assert len({dataset.num_vertices(name) for name in SPEAKERS}) == len(SPEAKERS)
    neutral = neutral_of("bob", SIZE)
    centre = neutral[landmark_indices(face(*SIZE)[0])].mean(axis=0)
    true = moving(neutral, 1)[3] - centre
    off = SurfaceTree(true.astype(np.float64), face(*SIZE)[1]).nearest(points[0])[1]
    assert off.max() < 1.2e-4  # float16 of 0.1 m: 0.03 mm along an axis
    with pytest.raises(ValueError, match="no corresponding vertices"):
        dataset.vertex_displacements(topology, sequence)
    with pytest.raises(ValueError, match="scans are of 30 frames a second, not 25"):
        dataset.scans(sequence.at(25.0))


def test_what_does_not_fit_is_said(folder: Path, tmp_path: Path) -> None:
    def broken(name: str) -> Path:
        return Path(shutil.copytree(folder, tmp_path / name))

    fewer = broken("fewer")
    (fewer / "scans" / "ann_1" / "0003.ply").unlink()
    excluded = check_dataset(fewer).excluded
    assert excluded["ann_1"].endswith("holds 11 scans, its landmarks are of 12 frames")
    nobody = broken("nobody")
    (nobody / "scans" / "bob.ply").unlink()
    assert check_dataset(nobody).excluded["bob_1"].startswith("there is no neutral scan of bob")
    elsewhere = broken("elsewhere")
    write_ply(elsewhere / "scans" / "ann.ply", *remeshed(neutral_of("ann", SIZE) + 0.05, 0))
    with pytest.raises(DatasetError, match=r"landmark \d+ of ann is \d+ mm away"):
        packed(elsewhere)
    with pytest.raises(DatasetError, match="cannot be made 24"):
        packed(broken("slower"), fps=24)


def test_chamfer_is_the_squared_distance_of_two_planes() -> None:
    side = np.linspace(0, 10, 21)
    x, y = np.meshgrid(side, side)
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 1, corner + 21], 1),
                            np.stack([corner + 1, corner + 22, corner + 21], 1)])  # fmt: skip
    plane = np.stack([x, y, np.zeros_like(x)], -1).reshape(1, -1, 3)
    moved = torch.tensor(plane, requires_grad=True)
    scan = torch.tensor(plane + [0.0, 0.0, 2.0])
    loss = chamfer_loss(moved, faces, scan)
    assert loss.item() == pytest.approx(8.0)  # 2^2, both ways
    loss.backward()
    gradient = moved.grad
    assert gradient is not None and (gradient[..., 2] < 0).all()  # towards the scan
    assert gradient[..., :2].abs().max() < 1e-9
    outlier = torch.cat([scan, scan[:, :1] + torch.tensor([0.0, 0.0, 500.0])], dim=1)
    assert chamfer_loss(moved, faces, outlier).item() == pytest.approx(8.0)
    marks = torch.full((1, 68, 3), 100.0)
    assert scan_errors(moved.detach(), moved[0].detach() - 1, faces, scan, marks)[0] == 2.0


def true_motion(dataset: Dataset) -> np.ndarray:
    """(T, V, 3) how the held-out speaker's vertices move: they lie on the surface whose motion is known."""
    mesh = dataset.mesh(*dataset.faces("val")[0])
    neutral, faces = neutral_of("bob", SIZE).astype(np.float64), face(*SIZE)[1]
    places = mesh.vertices + neutral[landmark_indices(face(*SIZE)[0])].mean(axis=0)
    corners = faces[SurfaceTree(neutral, faces).nearest(places)[2].reshape(-1)]
    shares, _ = closest_on_triangles(places, neutral[corners])
    moved = moving(neutral, 1) - neutral
    return np.asarray(np.einsum("tvkc,vk->tvc", moved[:, corners], shares))


def relative_errors(scans: Path, weights: Path) -> list[float]:
    """Mean error of the held-out speaker's vertices over that of a still face's: of all, and of the forehead."""
    dataset = open_dataset(scans)
    (sequence,) = dataset.sequences("val")
    mesh = dataset.mesh(*dataset.faces("val")[0])
    model = Stm.from_pretrained(weights).eval()
    options = model.options
    operators = surface_operators(
        mesh.vertices.astype(np.float64) / options.length_scale, mesh.faces, k=options.k_eig
    ).to(dtype=torch.float32)
    with torch.no_grad():
        features = model.encode(torch.from_numpy(mesh.vertices), operators)
        landmarks = torch.from_numpy(dataset.landmarks(sequence))
        made = model.decode(features, operators, landmarks).numpy()
    true = true_motion(dataset)
    centre = neutral_of("bob", SIZE)[landmark_indices(face(*SIZE)[0])].mean(axis=0)
    parts = [np.ones(len(mesh.vertices)), above(mesh.vertices + centre)]
    error, motion = np.linalg.norm(made - true, axis=-1), np.linalg.norm(true, axis=-1)
    return [float((error @ part).sum() / (motion @ part).sum()) for part in parts]


def test_registered_error_falls_without_correspondences(scans: Path, tmp_path: Path) -> None:
    options = [*QUICK, "loop.max_steps=120", "loop.validate_every=120", "loop.learning_rate=5e-3"]
    options += ["task.source_weights=null", "task.num_meshes=0", "loop.ema_decay=0"]
    found = []
    for weight in (0, 10):
        own = f"task.chamfer_weight={weight}"
        run("stm", CONFIGS / "stm_smoke.yaml", [*options, own], scans, tmp_path / own)
        found.append(relative_errors(scans, tmp_path / own / "stm"))
    landmarks_alone, both = found
    assert both[0] < 0.65  # a still face has 1
    assert both[1] < 0.65 and both[1] < landmarks_alone[1] - 0.02  # only the scans tell
