"""A face model on scans: what made noisy, partial scans is found again, and bad scans are refused in one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_layouts import write_flame
from scipy.spatial.transform import Rotation

from freetalk.cli.app import main
from freetalk.corpus.assets import EXTENTS
from freetalk.corpus.linear_face import built_in_head
from freetalk.data.expressive_faces import ExpressiveFace, FlameFace
from freetalk.data.flame import read_flame
from freetalk.data.registration import RegisterOptions, Scan, register
from freetalk.geometry import SurfaceTree
from freetalk.mesh import Mesh, load_mesh, save_mesh, vertex_normals

MOVED = ("jawOpen", "mouthSmile_L", "browInnerUp_L", "mouthPucker")
OPTIONS = RegisterOptions(points=700)


def scanned(
    face: ExpressiveFace, posed: np.ndarray, seed: int, noise_m: float = 0.0005
) -> tuple[Scan, np.ndarray]:
    """What a scanner before a turned face sees of it, with noise and outliers; and the turn."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([0.1, 0.4 + 0.02 * seed, -0.1]).as_matrix()
    points = posed @ turn.T + [0.02, 0.01, 0.3]
    normals = vertex_normals(points, face.faces)
    chosen = face.faces[rng.choice(len(face.faces), 3000)]
    shares = rng.dirichlet((1, 1, 1), len(chosen))
    seen = normals[chosen].mean(axis=1)[:, 2] > 0.2
    cloud = np.einsum("ncd,nc->nd", points[chosen], shares)[seen]
    cloud = cloud + rng.normal(0, noise_m, cloud.shape)
    outliers = rng.uniform(points.min(axis=0), points.max(axis=0), (80, 3))
    marks = points[face.landmarks] + rng.normal(0, 0.0015, (68, 3))
    return Scan(np.concatenate([cloud, outliers]), None, marks), turn


@pytest.fixture(scope="module")
def face() -> ExpressiveFace:
    return built_in_head()


@pytest.fixture(scope="module")
def truth(face: ExpressiveFace) -> tuple[np.ndarray, np.ndarray]:
    """An identity and weights of four frames of a mouth that opens."""
    identity = np.random.default_rng(0).normal(0, 0.8, len(face.identity_basis))
    weights = np.zeros((4, len(face.names)))
    for number, name in enumerate(MOVED):
        weights[:, face.names.index(name)] = np.linspace(0.05, 0.5 - 0.1 * number, 4)
    return identity, weights


@pytest.mark.slow
def test_noisy_partial_scans_are_found_again(face, truth):
    posed = face.posed(*truth)
    made = [scanned(face, own, t) for t, own in enumerate(posed)]
    # Only the first frame knows its landmarks, as of a sequence of point clouds.
    scans = [made[0][0], *(Scan(scan.points) for scan, _ in made[1:])]
    found = register(scans, face, options=OPTIONS)
    front = np.arange(EXTENTS["narrow"])
    triangles = np.ascontiguousarray(face.faces, np.int32)
    for t, own in enumerate(posed):
        away = SurfaceTree(found.vertices[t], triangles).nearest(own[front])[1]
        # A third of the noise of a single point, whose neighbours average it out.
        assert 1000 * away.mean() < 0.25
        apart = found.rotation[t] @ made[t][1].T
        assert np.degrees(np.arccos(np.clip((np.trace(apart) - 1) / 2, -1, 1))) < 1.0
        placed = found.canonical(scans[t].points, t)
        assert np.median(SurfaceTree(found.vertices[t], triangles).nearest(placed)[1]) < 0.001
    assert (found.weights >= 0).all() and (found.weights <= 1).all()
    upper, lower = (face.landmarks[index] for index in (62, 66))
    opening, true = (v[:, upper, 1] - v[:, lower, 1] for v in (found.vertices, posed))
    # The last frame, 12 mm away from its start and without landmarks, within a tenth of its opening.
    assert np.abs(opening - true).max() < 0.1 * true.max()


def test_a_known_identity_is_kept(face, truth):
    identity, weights = truth
    scan, _ = scanned(face, face.posed(identity, weights[:1])[0], 0)
    found = register([scan], face, options=OPTIONS, identity=identity)
    assert np.array_equal(found.identity, identity)
    assert (
        abs(found.weights[0, face.names.index("jawOpen")] - weights[0, face.names.index("jawOpen")])
        < 0.1
    )


def test_flame_and_its_jaw_are_found_again(tmp_path):
    write_flame(tmp_path / "flame.npz")
    flame = read_flame(tmp_path / "flame.npz")
    marks = np.linspace(0, len(flame.template) - 1, 68).astype(int)
    face = FlameFace.of(flame, marks, num_shapes=10, num_expressions=5)
    weights = np.zeros((1, len(face.names)))
    weights[0, -3] = 0.25  # radians
    posed = face.posed(np.zeros(10), weights)
    found = register(
        [Scan(posed[0], None, posed[0][marks])], face, options=RegisterOptions(points=0)
    )
    assert abs(found.weights[0, -3] - 0.25) < 0.02
    assert 1000 * np.linalg.norm(found.vertices[0] - posed[0], axis=1).mean() < 0.5


def test_scans_that_cannot_be_registered_are_refused(face, truth):
    scan, _ = scanned(face, face.posed(truth[0], truth[1][:1])[0], 0)
    with pytest.raises(ValueError, match="no scan"):
        register([], face)
    with pytest.raises(ValueError, match="has 0 landmarks; 12 are needed"):
        register([Scan(scan.points)], face)
    with pytest.raises(ValueError, match="not finite"):
        register([Scan(scan.points * np.nan, None, scan.landmarks)], face)
    with pytest.raises(ValueError, match="hardly meet"):
        register([Scan(scan.points + 1.0, None, scan.landmarks)], face, options=OPTIONS)


@pytest.mark.slow
def test_command_writes_meshes_in_the_heads_frame(tmp_path: Path, face, truth, capsys):
    posed = face.posed(truth[0], truth[1][:2])
    files = []
    for t, own in enumerate(posed):
        turn = Rotation.from_euler("y", 20, degrees=True).as_matrix()
        save_mesh(tmp_path / f"scan{t}.ply", Mesh(100 * own @ turn.T, face.faces.tolist()))
        files.append(str(tmp_path / f"scan{t}.ply"))
    (tmp_path / "marks.json").write_text(str(face.landmarks.tolist()))
    out = tmp_path / "out"
    told = ["head", "register", *files, "--landmarks", str(tmp_path / "marks.json")]
    assert main([*told, "--points", "700", "--out", str(out)]) == 0
    assert "unit: cm" in capsys.readouterr().out
    with np.load(out / "registration.npz") as archive:
        assert (
            archive["weights"].shape == (2, len(face.names)) and (archive["error_mm"] < 0.3).all()
        )
    registered = np.asarray(load_mesh(out / "scan1.ply").vertices)
    aligned = np.asarray(load_mesh(out / "aligned" / "scan1.ply").vertices)
    assert 1000 * np.linalg.norm(registered - aligned, axis=1).mean() < 1.0
    assert main([*told, "--points", "700", "--out", str(out)]) != 0
    assert "is not empty" in capsys.readouterr().err


def test_command_registers_clouds_with_landmarks(tmp_path: Path, face, truth, capsys):
    scan, _ = scanned(face, face.posed(truth[0], truth[1][:1])[0], 0)
    np.save(tmp_path / "cloud.npy", scan.points)
    command = ["head", "register", str(tmp_path / "cloud.npy"), "--out", str(tmp_path / "out")]
    assert main(command) != 0
    assert "give --landmarks as .npy" in capsys.readouterr().err
    np.save(tmp_path / "marks.npy", scan.landmarks)
    assert main([*command, "--landmarks", str(tmp_path / "marks.npy"), "--points", "700"]) == 0
    assert np.load(tmp_path / "out" / "aligned" / "cloud.npy").shape == scan.points.shape
