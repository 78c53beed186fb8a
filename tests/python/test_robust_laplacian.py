"""Laplacians against the public packages: robust_laplacian, potpourri3d, libigl."""

from __future__ import annotations

from typing import TYPE_CHECKING

import igl
import numpy as np
import potpourri3d
import pytest
import robust_laplacian
import torch
from scipy import sparse

from freetalk import geometry

if TYPE_CHECKING:
    from numpy.typing import NDArray


def bumpy_grid(n: int = 24) -> tuple[NDArray, NDArray]:
    """A height field with uneven edges, some of them not Delaunay: (V, 3) vertices, (F, 3) faces."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
    points = np.stack([x, y, 0.2 * np.sin(5 * x) * np.cos(4 * y)], -1).reshape(-1, 3)
    points[:, :2] += rng.uniform(-0.4, 0.4, (n * n, 2)) / n
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return points, faces


def closed_tube(n: int = 20) -> tuple[NDArray, NDArray]:
    """A torus of uneven tubes: closed, no boundary."""
    rng = np.random.default_rng(1)
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    angle_u = 2 * np.pi * (u + rng.uniform(-0.3, 0.3, u.shape)) / n
    angle_v = 2 * np.pi * (v + rng.uniform(-0.3, 0.3, v.shape)) / n
    radius = 1 + (0.4 + 0.1 * np.sin(3 * angle_u)) * np.cos(angle_v)
    points = [radius * np.cos(angle_u), radius * np.sin(angle_u), 0.4 * np.sin(angle_v)]
    a, b = u * n + v, u * n + (v + 1) % n
    c, d = (u + 1) % n * n + (v + 1) % n, (u + 1) % n * n + v
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    return np.stack(points, -1).reshape(-1, 3), faces


def meshes() -> dict[str, tuple[NDArray, NDArray]]:
    """Closed, open, torn, non-manifold, degenerate, badly scaled."""
    rng = np.random.default_rng(2)
    vertices, faces = bumpy_grid()
    cases = {"open": (vertices, faces), "closed": closed_tube()}
    cases["torn"] = (vertices, faces[rng.random(len(faces)) < 0.6])
    cases["soup"] = (vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))
    turned = faces.copy()
    turned[::2] = turned[::2, ::-1]
    cases["orientation"] = (vertices, turned)
    cases["unreferenced"] = (np.concatenate([vertices, rng.random((5, 3))]), faces)
    fins = rng.integers(0, len(vertices), (40, 1))
    cases["fins"] = (vertices, np.concatenate([faces, np.c_[faces[:40, :2], fins]]))
    random = np.stack([rng.choice(60, 3, replace=False) for _ in range(600)])
    cases["tangle"] = (rng.random((60, 3)), random)
    repeated = [faces, faces[:90], faces[:50, [1, 2, 0]], faces[20:70, ::-1]]
    cases["duplicate faces"] = (vertices, np.concatenate(repeated))
    collinear = vertices.copy()
    collinear[faces[50, 2]] = collinear[faces[50, :2]].mean(0)
    cases["collinear face"] = (collinear, faces)
    coincident = vertices.copy()
    coincident[100] = coincident[101]
    cases["coincident vertices"] = (coincident, faces)
    pinched = faces.copy()
    pinched[7:500:40, 1] = pinched[7:500:40, 0]
    cases["vertex twice in a face"] = (vertices, pinched)
    cases["flat"] = (vertices * [1, 0, 0], faces)
    cases["needles"] = (vertices * [1, 1e-3, 1e-3], faces)
    cases["huge"] = (vertices * 1e6, faces)
    cases["tiny"] = (vertices * 1e-6, faces)
    return cases


MESHES = meshes()


@pytest.mark.parametrize("name", MESHES)
def test_robust_laplacian_equals_the_public_one(name: str) -> None:
    vertices, faces = MESHES[name]
    ours, mass = geometry.robust_laplacian(vertices, faces)
    theirs, their_mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    # The same triangulation and formula; rounding grows with the needles that mollification leaves.
    assert abs(ours - theirs).max() < 1e-8 * abs(theirs).max()
    assert np.abs(mass - their_mass.diagonal()).max() < 1e-8 * their_mass.diagonal().max()


@pytest.mark.parametrize("factor", [0.0, 1e-3, 0.1])
def test_mollification_equals_the_public_one(factor: float) -> None:
    vertices, faces = MESHES["torn"]
    ours, _ = geometry.robust_laplacian(vertices, faces, mollify_factor=factor)
    theirs, _ = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64), factor)
    assert abs(ours - theirs).max() < 1e-8 * abs(theirs).max()


def clouds() -> dict[str, NDArray]:
    """Surfaces with and without boundary, noise, no surface at all, away from the origin."""
    rng = np.random.default_rng(3)
    sphere = rng.standard_normal((2000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    return {
        "sphere": sphere,
        "noisy sphere": sphere + 0.02 * rng.standard_normal(sphere.shape),
        "height field": bumpy_grid(36)[0],
        "shifted": bumpy_grid(30)[0] + [10, 20, 30],
        "volume": rng.random((800, 3)),
        "plane": rng.random((800, 3)) * [1, 1, 0],
    }


CLOUDS = clouds()


@pytest.mark.parametrize("name", CLOUDS)
def test_point_cloud_laplacian_equals_the_public_one(name: str) -> None:
    points = CLOUDS[name]
    for num_neighbors in (12, 30):
        ours, mass = geometry.point_cloud_laplacian(points, num_neighbors=num_neighbors)
        theirs, their_mass = robust_laplacian.point_cloud_laplacian(
            points, n_neighbors=num_neighbors
        )
        assert abs(ours - theirs).max() < 1e-8 * abs(theirs).max()
        assert np.abs(mass - their_mass.diagonal()).max() < 1e-8 * their_mass.diagonal().max()


def test_exact_fit_of_a_point_cloud_follows_a_translation() -> None:
    points = CLOUDS["height field"]
    here, _ = geometry.point_cloud_laplacian(points, published_fit=False)
    there, _ = geometry.point_cloud_laplacian(points + [3.0, -7.0, 5.0], published_fit=False)
    assert abs(here - there).max() < 1e-9 * abs(here).max()  # coordinates lose a digit


@pytest.mark.parametrize("name", ["open", "closed", "torn", "fins", "tangle", "orientation"])
def test_cotan_laplacian_equals_the_public_ones(name: str) -> None:
    vertices, faces = MESHES[name]
    absolute = geometry.cotan_laplacian(vertices, faces, regularization="absolute")
    guarded = potpourri3d.cotan_laplacian(vertices, faces, denom_eps=1e-10)
    scale = abs(guarded).max()
    assert abs(absolute - guarded).max() < 1e-10 * scale  # the same formula: rounding only
    relative = geometry.cotan_laplacian(vertices, faces)
    exact = -igl.cotmatrix(vertices, faces.astype(np.int64))
    assert abs(relative - exact).max() < 1e-10 * scale  # no face here is thin enough for the guard


def test_robust_operators_solve_the_public_eigenproblem() -> None:
    vertices, faces = MESHES["fins"]
    operators = geometry.surface_operators(vertices, faces, k=20, cache=False, laplacian="robust")
    laplacian, mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    evals = sparse.linalg.eigsh(laplacian, 20, mass, sigma=-1e-6, return_eigenvectors=False)
    assert np.allclose(operators.evals.numpy()[1:], np.sort(evals)[1:], rtol=1e-5)


def test_point_clouds_have_operators(tmp_path) -> None:
    points = CLOUDS["sphere"]
    none = np.zeros((0, 3), dtype=int)
    first = geometry.surface_operators(points, none, k=9, cache=tmp_path, laplacian="robust")
    again = geometry.surface_operators(points, none, k=9, cache=tmp_path, laplacian="robust")
    assert torch.equal(first.evecs, again.evecs)
    assert len(list((tmp_path / "operators").iterdir())) == 1
    # l (l + 1), 2 l + 1 times; 2000 random points are a few percent off.
    expected = np.repeat([0.0, 2.0, 6.0], [1, 3, 5])
    # The zero is that of the 1e-8 on the diagonal, over masses of 4 pi / 2000.
    assert np.allclose(first.evals.numpy(), expected, rtol=0.1, atol=1e-5)
    assert (first.normals.numpy() * points).sum(1).min() > 0.8  # outwards
    with pytest.raises(ValueError, match='laplacian = "robust"'):
        geometry.surface_operators(points, none, k=9, cache=False)


def test_laplacians_are_cached_apart(tmp_path) -> None:
    vertices, faces = MESHES["fins"]
    cotan = geometry.surface_operators(vertices, faces, k=5, cache=tmp_path)
    robust = geometry.surface_operators(vertices, faces, k=5, cache=tmp_path, laplacian="robust")
    assert len(list((tmp_path / "operators").iterdir())) == 2
    assert not torch.allclose(cotan.evals[1:], robust.evals[1:])
    with pytest.raises(ValueError, match='"cotan" or "robust"'):
        geometry.surface_operators(vertices, faces, k=5, cache=False, laplacian="graph")
