"""The eigenbasis from Python: parity with scipy, progress; the operator cache used by several processes."""

from __future__ import annotations

import multiprocessing
import os
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from freetalk import geometry
from freetalk.corpus import assets

Arrays = tuple[NDArray, NDArray]


@pytest.fixture(scope="module")
def face() -> Arrays:
    """The shipped face: 6706 vertices."""
    vertices, faces = assets.mean_face("narrow")
    return vertices.astype(float), faces


def bumpy_grid(n: int, seed: int = 0) -> Arrays:
    """A height field with uneven edges: (V, 3) vertices and (F, 3) faces."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    points = np.stack([x, y, 0.2 * np.sin(5 * x) * np.cos(4 * y)], -1).reshape(-1, 3)
    points[:, :2] += rng.uniform(-0.2, 0.2, (n * n, 2)) / n
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return points, faces


def test_eigenbasis_of_a_face_equals_scipys(face: Arrays) -> None:
    laplacian = geometry.cotan_laplacian(*face)
    mass = geometry.lumped_mass(*face)
    basis = geometry.eigenbasis(laplacian, mass, 96, progress=False)
    shifted = (laplacian + 1e-8 * sp.identity(len(mass))).tocsc()
    evals, evecs = eigsh(shifted, 96, sp.diags(mass).tocsc(), sigma=-100.0)
    # Residuals of at most 1e-6: eigenvalues are right to their square, scipy's to rounding.
    assert np.allclose(basis.evals[1:], evals[1:], rtol=1e-9)
    assert basis.residuals.max() <= 1e-6
    assert np.allclose(basis.evecs.T @ (mass[:, None] * basis.evecs), np.eye(96), atol=1e-9)
    decay = np.exp(-basis.evals / basis.evals[48])
    probe = np.random.default_rng(0).standard_normal((len(mass), 4))
    ours = basis.evecs @ (decay[:, None] * (basis.evecs.T @ probe))
    theirs = evecs @ (decay[:, None] * (evecs.T @ probe))
    assert np.abs(ours - theirs).max() < 1e-6 * np.abs(theirs).max()


def test_eigenbasis_has_the_same_bits_for_any_number_of_threads(face: Arrays) -> None:
    before = torch.get_num_threads()
    bases = []
    for threads in (1, 3):
        torch.set_num_threads(threads)
        operators = geometry.surface_operators(*face, k=32, cache=False, progress=False)
        bases.append(operators.evecs)
    torch.set_num_threads(before)
    assert torch.equal(bases[0], bases[1])


def test_progress_goes_from_zero_to_one_and_can_stop(face: Arrays) -> None:
    shares: list[float] = []
    geometry.surface_operators(*face, k=16, cache=False, progress=shares.append)
    assert len(shares) > 5
    assert shares == sorted(shares)
    assert 0 < shares[0] < 0.5
    assert shares[-1] == 1.0

    def stop(share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        geometry.surface_operators(*face, k=16, cache=False, progress=stop)


def test_eigenbasis_refuses_bad_input() -> None:
    vertices, faces = bumpy_grid(5)
    laplacian = geometry.cotan_laplacian(vertices, faces)
    mass = geometry.lumped_mass(vertices, faces)
    assert geometry.eigenbasis(laplacian, mass, 25, progress=False).evecs.shape == (25, 25)
    with pytest.raises(ValueError, match=r"bust was asked for 26.*k_eig <= 25"):
        geometry.eigenbasis(laplacian, mass, 26, name="bust", progress=False)
    with pytest.raises(ValueError, match="positive mass"):
        geometry.eigenbasis(laplacian, 0 * mass, 4, progress=False)
    with pytest.raises(ValueError, match="solver"):
        geometry.eigenbasis(laplacian, mass, 4, solver="arpack", progress=False)
    vertices, faces = bumpy_grid(15)
    laplacian, mass = (
        geometry.cotan_laplacian(vertices, faces),
        geometry.lumped_mass(vertices, faces),
    )
    with pytest.raises(RuntimeError, match="bust did not converge"):
        geometry.eigenbasis(laplacian, mass, 4, tolerance=1e-19, name="bust", progress=False)


def _use_cache(folder: str, ready: str, max_bytes: int) -> list[list[float]]:
    """Asks for the operators of six meshes again and again, once the other process is there too."""
    torch.set_num_threads(1)
    meshes = [bumpy_grid(12, seed) for seed in range(6)]
    Path(ready, str(os.getpid())).touch()
    deadline = time.monotonic() + 300
    while len(list(Path(ready).iterdir())) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    rng = np.random.default_rng(os.getpid())
    found: list[list[float]] = [[] for _ in meshes]
    for _ in range(60):
        index = int(rng.integers(len(meshes)))
        operators = geometry.surface_operators(
            *meshes[index], k=8, cache=folder, max_cache_bytes=max_bytes, progress=False
        )
        found[index].append(float(operators.evals[7]))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kept", [1.5, 100.0])
def test_cache_is_safe_with_two_processes(tmp_path: Path, kept: float) -> None:
    meshes = [bumpy_grid(12, seed) for seed in range(6)]
    right = [
        float(geometry.surface_operators(*mesh, k=8, cache=tmp_path / "alone").evals[7])
        for mesh in meshes
    ]
    size = next((tmp_path / "alone" / "operators").iterdir()).stat().st_size
    (tmp_path / "ready").mkdir()
    arguments = (str(tmp_path / "both"), str(tmp_path / "ready"), int(kept * size))
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        jobs = [pool.apply_async(_use_cache, arguments) for _ in range(2)]
        results = [job.get(timeout=600) for job in jobs]  # to load torch takes minutes at times
    for found in results:
        for values, value in zip(found, right):
            assert values == [value] * len(values)  # the same bits, read or computed
    entries = list((tmp_path / "both" / "operators").iterdir())
    assert all(entry.suffix == ".safetensors" for entry in entries)
    # With room for one and a half, what the two wrote last may lie side by side.
    assert len(entries) <= 2 if kept < 2 else len(entries) == 6


def test_cache_does_not_keep_what_is_larger_than_its_limit(tmp_path: Path) -> None:
    vertices, faces = bumpy_grid(8)
    geometry.surface_operators(vertices, faces, k=6, cache=tmp_path, max_cache_bytes=1000)
    assert not list(tmp_path.glob("operators/*"))


def test_cache_removes_what_a_killed_process_left(tmp_path: Path) -> None:
    folder = tmp_path / "operators"
    folder.mkdir()
    old, new = folder / "a.safetensors.tmp-1-0", folder / "b.safetensors.tmp-2-0"
    for file in (old, new):
        file.write_bytes(b"half")
    os.utime(old, (time.time() - 7200, time.time() - 7200))
    geometry.surface_operators(*bumpy_grid(8), k=6, cache=tmp_path)
    assert not old.exists()
    assert new.exists()  # perhaps still being written


def test_cache_notices_a_changed_shape(tmp_path: Path) -> None:
    vertices, faces = bumpy_grid(4)  # 16 vertices, 4 pairs: evecs (16, 4)
    first = geometry.surface_operators(vertices, faces, k=4, cache=tmp_path)
    (entry,) = (tmp_path / "operators").iterdir()
    good = entry.read_bytes()
    assert good.count(b"[16,4]") == 1
    entry.write_bytes(good.replace(b"[16,4]", b"[4,16]"))
    second = geometry.surface_operators(vertices, faces, k=4, cache=tmp_path)
    assert torch.equal(first.evecs, second.evecs)
    assert entry.read_bytes() == good
