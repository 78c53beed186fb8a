"""Geometry from Python: parity with public Laplacians and scipy, alignment of real heads."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
import torch

import freetalk as ft
from freetalk import geometry

if TYPE_CHECKING:
    from numpy.typing import NDArray

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "data"
needs_shared = pytest.mark.skipif(
    not (SHARED / "ict_facekit").is_dir(), reason=f"the development faces are not at {SHARED}"
)


def bumpy_grid(n: int = 24) -> tuple[NDArray, NDArray]:
    """A height field with uneven edges: (V, 3) vertices and (F, 3) faces."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    points = np.stack([x, y, 0.2 * np.sin(5 * x) * np.cos(4 * y)], -1).reshape(-1, 3)
    points[:, :2] += rng.uniform(-0.2, 0.2, (n * n, 2)) / n
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return points, faces


def test_cotan_laplacian_equals_the_public_one() -> None:
    potpourri3d = pytest.importorskip("potpourri3d")
    vertices, faces = bumpy_grid()
    ours = geometry.cotan_laplacian(vertices, faces, regularization="absolute")
    theirs = potpourri3d.cotan_laplacian(vertices, faces, denom_eps=1e-10)
    assert abs(ours - theirs).max() < 1e-10  # the same formula: rounding only
    relative = geometry.cotan_laplacian(vertices, faces)
    # Faces of area 1e-3: the public 1e-10 in the denominator changes weights by 1e-7.
    assert abs(relative - theirs).max() < 1e-6


def test_mass_equals_the_public_one() -> None:
    potpourri3d = pytest.importorskip("potpourri3d")
    vertices, faces = bumpy_grid()
    theirs = potpourri3d.vertex_areas(vertices, faces)
    theirs = theirs + 1e-8 * theirs.mean()
    assert np.allclose(geometry.lumped_mass(vertices, faces), theirs, rtol=1e-12)


def test_eigenbasis_equals_scipy_and_its_heat_kernel() -> None:
    scipy_sparse = pytest.importorskip("scipy.sparse")
    from scipy.sparse.linalg import eigsh

    vertices, faces = bumpy_grid()
    operators = geometry.surface_operators(vertices, faces, k=40, cache=False)
    mass = operators.mass.numpy()
    laplacian = geometry.cotan_laplacian(vertices, faces)
    laplacian = laplacian + 1e-8 * scipy_sparse.identity(len(vertices))
    evals, evecs = eigsh(laplacian.tocsc(), 40, scipy_sparse.diags(mass).tocsc(), sigma=-1e-2)
    assert np.allclose(operators.evals.numpy()[1:], evals[1:], rtol=1e-8)
    assert operators.residuals.max() < 1e-6
    phi = operators.evecs.numpy()
    time = 0.01  # the kernel ignores signs and the order within an eigenspace
    ours = phi @ np.diag(np.exp(-time * operators.evals.numpy())) @ phi.T
    theirs = evecs @ np.diag(np.exp(-time * evals)) @ evecs.T
    assert np.abs(ours - theirs).max() < 1e-7 * np.abs(theirs).max()


def test_gradients_equal_the_public_formula_written_out() -> None:
    vertices, faces = bumpy_grid(9)
    operators = geometry.surface_operators(
        vertices, faces, k=4, cache=False, regularization="absolute"
    )
    frames = operators.frames.numpy()
    dense = operators.gradients.to_dense().numpy().reshape(2, len(vertices), len(vertices))
    neighbours: list[set[int]] = [set() for _ in vertices]
    for face in faces:
        for i, j in itertools.permutations(face, 2):
            neighbours[i].add(int(j))
    for i, around in enumerate(neighbours):
        js = sorted(around)
        edges = (vertices[js] - vertices[i]) @ frames[i, :2].T
        weights = np.linalg.inv(edges.T @ edges + 1e-5 * np.eye(2)) @ edges.T
        assert np.allclose(dense[:, i, js], weights, atol=1e-9 * np.abs(weights).max())
        assert np.allclose(dense[:, i, i], -weights.sum(1), atol=1e-9 * np.abs(weights).max())


def test_normals_equal_the_public_formula_written_out() -> None:
    """Its 1e-6 beside a face's cross product takes weight from small faces: here they are 4e-7 to 4e-6."""
    vertices, faces = bumpy_grid(9)
    vertices = vertices * np.linspace(5e-3, 15e-3, len(vertices))[:, None]
    operators = geometry.surface_operators(
        vertices, faces, k=4, cache=False, regularization="absolute"
    )
    cross = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    of_faces = cross / (np.linalg.norm(cross, axis=1, keepdims=True) + 1e-6)
    expected = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(expected, faces[:, corner], of_faces)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(operators.normals.numpy() - expected).max() < 1e-12
    plain = geometry.surface_operators(vertices, faces, k=4, cache=False).normals.numpy()
    assert np.abs(plain - expected).max() > 1e-3


def test_operators_accept_tensors_and_convert() -> None:
    vertices, faces = bumpy_grid(8)
    operators = geometry.surface_operators(
        torch.from_numpy(vertices), torch.from_numpy(faces), k=6, cache=False
    )
    half = operators.to(torch.float32, "cpu")
    assert half.mass.dtype == torch.float32
    assert half.gradients.shape == (128, 64)
    assert torch.allclose(operators.scaled(2.0).evals, operators.evals / 4, atol=1e-12, rtol=1e-12)


def test_operators_are_cached(tmp_path: Path) -> None:
    vertices, faces = bumpy_grid(8)
    first = geometry.surface_operators(vertices, faces, k=6, cache=tmp_path)
    entries = list((tmp_path / "operators").iterdir())
    assert len(entries) == 1
    entries[0].write_bytes(b"damaged")
    second = geometry.surface_operators(vertices, faces, k=6, cache=tmp_path)
    assert torch.equal(first.evecs, second.evecs)
    assert entries[0].stat().st_size > 1000


def test_operators_refuse_bad_input() -> None:
    vertices, faces = bumpy_grid(4)
    with pytest.raises(ValueError, match="k_eig <= 16"):
        geometry.surface_operators(vertices, faces, k=17, cache=False)
    with pytest.raises(ValueError, match="integers"):
        geometry.surface_operators(vertices, faces.astype(float), k=4, cache=False)
    with pytest.raises(ValueError, match="regularization"):
        geometry.surface_operators(vertices, faces, k=4, cache=False, regularization="none")


def test_mesh_round_trip(tmp_path: Path) -> None:
    vertices, faces = bumpy_grid(4)
    mesh = ft.Mesh(vertices, [*faces.tolist(), [0, 1, 5, 4]], name="grid")
    assert mesh.faces.shape == (len(faces) + 2, 3)
    for name in ("a.obj", "a.ply"):
        ft.mesh.save_mesh(tmp_path / name, mesh)
        again = ft.load_mesh(str(tmp_path / name))
        assert np.array_equal(again.vertices, vertices)
        assert again.polygons == mesh.polygons
    with pytest.raises(RuntimeError, match="does not exist"):
        ft.load_mesh(tmp_path / "none.obj")
    with pytest.raises(ValueError, match="keep their shape"):
        mesh.vertices = vertices[:3]


class Face(NamedTuple):
    """A face to align: cm, +Y up, +Z forward; landmarks (68, 3)."""

    vertices: NDArray
    faces: NDArray
    landmarks: NDArray
    tolerance_mm: float


class Faces(NamedTuple):
    """The template (metres, canonical) and faces to align to it."""

    points: NDArray
    normals: NDArray
    landmarks: NDArray
    faces: dict[str, Face]


@pytest.fixture(scope="module")
def real_faces() -> Faces:
    ict = np.load(SHARED / "ict_facekit" / "ict_facekit.npz")
    neutral = ict["neutral"].astype(float)
    index = ict["landmarks68"]
    modes = ict["identity"][:, :].astype(np.float32)

    def triangles(count: int) -> NDArray:
        quads = ict["faces"][(ict["faces"] < count).all(1)]
        polygons = [list(q[:3]) if q[3] < 0 else list(q) for q in quads]
        return ft.Mesh(neutral[:count], polygons).faces

    origin = neutral[index].mean(0)
    canonical = (neutral - origin) * 0.01
    points, normals = geometry.sample_template(canonical[:9409], triangles(9409))
    rng = np.random.default_rng(0)
    faces: dict[str, Face] = {}
    for count in (6706, 9409, 11248, 26719):
        identity = neutral + np.tensordot(rng.standard_normal(100), modes, 1)
        faces[f"ict_{count}"] = Face(identity[:count], triangles(count), identity[index], 6.0)
    mhr = np.load(SHARED / "mhr_head" / "mhr_head.npz")
    vertices = mhr["neutral"].astype(float)
    faces["mhr"] = Face(vertices, mhr["faces"], vertices[mhr["landmarks68"]], 12.0)
    folder = SHARED / "mediapipe_canonical"
    mask = ft.load_mesh(folder / "canonical_face_model.obj")
    subset = json.loads((folder / "landmarks68.json").read_text())
    subset = subset if isinstance(subset, list) else next(iter(subset.values()))
    faces["mediapipe"] = Face(mask.vertices, mask.faces, mask.vertices[subset], 12.0)
    return Faces(points, normals, canonical[index], faces)


def turned(seed: int) -> tuple[NDArray, str, str]:
    """A random axis permutation times a tilt of at most 8 degrees, and the names of its up and forward."""
    rng = np.random.default_rng(seed)
    proper = [
        np.diag(signs) @ np.eye(3)[list(order)]
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
        if np.linalg.det(np.diag(signs) @ np.eye(3)[list(order)]) > 0
    ]
    axis = rng.standard_normal(3)
    axis *= np.deg2rad(8) * rng.random() / np.linalg.norm(axis)
    cross = np.cross(np.eye(3), -axis)
    tilt = torch.linalg.matrix_exp(torch.from_numpy(cross)).numpy()
    rotation = proper[rng.integers(24)] @ tilt

    def name(direction: NDArray) -> str:
        largest = int(np.abs(direction).argmax())
        return ("-" if direction[largest] < 0 else "+") + "xyz"[largest]

    return rotation, name(rotation[:, 1]), name(rotation[:, 2])


@needs_shared
@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("ict_6706", "mm"),
        ("ict_9409", "cm"),
        ("ict_11248", "in"),
        ("ict_26719", "m"),
        ("mhr", "cm"),
        ("mhr", "m"),
        ("mediapipe", "mm"),
    ],
)
def test_alignment_recovers_unit_and_pose_of_real_faces(
    real_faces: Faces, name: str, unit: str
) -> None:
    face = real_faces.faces[name]
    per_cm = {"m": 0.01, "cm": 1.0, "mm": 10.0, "in": 1 / 2.54}[unit]
    rotation, up, forward = turned(seed=len(name) + len(unit))
    offset = np.array([30.0, -120.0, 55.0]) * per_cm
    alignment = geometry.align_to_template(
        per_cm * face.vertices @ rotation.T + offset,
        face.faces,
        real_faces.points,
        real_faces.normals,
    )
    landmarks = per_cm * face.landmarks @ rotation.T + offset
    found = alignment.to_canonical.apply(landmarks)
    error_mm = 1e3 * np.linalg.norm(found - real_faces.landmarks, axis=1).mean()
    assert (alignment.unit, alignment.up, alignment.forward) == (unit, up, forward)
    assert alignment.face_like, alignment.summary
    # The tolerance is mostly identity: the best similarity between the landmarks leaves 2-5 mm.
    assert error_mm < face.tolerance_mm, alignment.summary
    assert abs(alignment.to_canonical.scale * per_cm * 100 - 1) < 0.1


@needs_shared
@pytest.mark.slow
def test_alignment_warns_of_a_cow(real_faces: Faces) -> None:
    cow = ft.load_mesh(SHARED / "spot" / "spot.obj")
    alignment = geometry.align_to_template(
        cow.vertices, cow.faces, real_faces.points, real_faces.normals
    )
    assert not alignment.face_like
    assert "does not look like a face" in alignment.summary
