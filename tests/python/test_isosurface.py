"""Marching cubes: closed, manifold, where the field says, the same for any number of threads."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from freetalk import geometry
from freetalk.mesh import Mesh, mesh_report

Surface = tuple[NDArray, NDArray]


def is_closed_manifold(surface: Surface) -> bool:
    """Whether every edge has two triangles that run along it in opposite directions, and every vertex one fan."""
    report = mesh_report(Mesh(surface[0], surface[1].tolist()))
    return (
        report.boundary_edges == report.nonmanifold_edges == report.inconsistent_edges == 0
        and report.nonmanifold_vertices == report.repeated_corner_polygons == 0
        and report.coincident_vertices == report.unreferenced_vertices == 0
    )


def volume(surface: Surface) -> float:
    a, b, c = surface[0][surface[1]].transpose(1, 0, 2)
    return float(np.einsum("fd,fd->", a, np.cross(b, c))) / 6


def euler(surface: Surface) -> int:
    edges = np.sort(surface[1][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return len(surface[0]) - len(np.unique(edges, axis=0)) + len(surface[1])


def grid(size: int) -> NDArray:
    """(size, size, size, 3) places in [-1, 1]."""
    axis = np.linspace(-1, 1, size)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


def cells_of(values: NDArray) -> tuple[NDArray, NDArray]:
    """All corners (P, 3) of a grid in indices, and its cells (N, 8)."""
    shape = values.shape
    number = np.arange(values.size).reshape(shape)
    x, y, z = (
        (slice(None, -1), slice(1, None)),
        (slice(None, -1), slice(1, None)),
        (
            slice(None, -1),
            slice(1, None),
        ),
    )
    cells = np.stack([number[i, j, k].ravel() for i in x for j in y for k in z], axis=1)
    return np.stack(np.unravel_index(number.ravel(), shape), axis=1).astype(float), cells


def random_field(seed: int, shape: tuple[int, int, int]) -> NDArray:
    """Noise that is positive at the border: every case of a cell, many of them beside each other."""
    values = np.random.default_rng(seed).normal(size=shape)
    inside = np.pad(np.ones(np.subtract(shape, 2), dtype=bool), 1)
    return np.where(inside, values, np.abs(values)).astype(np.float32)


@pytest.mark.parametrize("case", range(256))
def test_every_case_is_closed_and_manifold(case: int) -> None:
    if case == 0:
        return
    values = np.ones((4, 4, 4), np.float32)
    values[1:3, 1:3, 1:3] -= 2 * (case >> np.arange(8).reshape(2, 2, 2) & 1)
    assert is_closed_manifold(geometry.isosurface(values))


@pytest.mark.parametrize("seed", range(12))
def test_random_fields_are_closed_and_manifold(seed: int) -> None:
    values = random_field(seed, (11, 9, 70 + seed))
    surface = geometry.isosurface(values)
    assert len(surface[1]) > 5000
    assert is_closed_manifold(surface)
    assert volume(surface) > 0


def test_values_at_the_level_leave_no_collapsed_triangle() -> None:
    values = np.random.default_rng(0).integers(-1, 2, (10, 10, 10)).astype(np.float32)
    surface = geometry.isosurface(np.pad(values, 1, constant_values=1))
    assert is_closed_manifold(surface)
    assert mesh_report(Mesh(surface[0], surface[1].tolist())).zero_area_triangles == 0


def test_sphere_has_its_volume_and_turns_outward() -> None:
    points, step = grid(65), 2 / 64
    surface = geometry.isosurface(
        np.linalg.norm(points, axis=-1) - 0.7, origin=(-1, -1, -1), spacing=(step, step, step)
    )
    assert is_closed_manifold(surface) and euler(surface) == 2
    assert volume(surface) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=2e-3)
    assert np.abs(np.linalg.norm(surface[0], axis=1) - 0.7).max() < step**2


def test_torus_has_its_volume_and_hole() -> None:
    points = grid(81)
    ring = np.hypot(points[..., 0], points[..., 1]) - 0.6
    surface = geometry.isosurface(
        np.hypot(ring, points[..., 2]), level=0.25, origin=(-1, -1, -1), spacing=(0.025,) * 3
    )
    assert is_closed_manifold(surface) and euler(surface) == 0
    assert volume(surface) == pytest.approx(2 * np.pi**2 * 0.6 * 0.25**2, rel=4e-3)


def test_vertices_are_those_of_libigl() -> None:
    values = random_field(3, (9, 10, 11))
    places = np.stack(np.meshgrid(*map(np.arange, values.shape), indexing="ij"), axis=-1)
    order = places.transpose(2, 1, 0, 3).reshape(-1, 3).astype(float)  # x fastest
    expected, *_ = igl.marching_cubes(
        values.transpose(2, 1, 0).ravel().astype(float), order, *values.shape, 0.0
    )
    vertices, _ = geometry.isosurface(values)
    assert len(vertices) == len(expected)
    order_of = [np.lexsort(np.round(v, 3).T) for v in (vertices, expected)]
    # Ours stay 1e-4 of an edge away from its ends.
    assert np.abs(vertices[order_of[0]] - expected[order_of[1]]).max() < 1.1e-3


def test_cells_give_the_surface_of_the_grid() -> None:
    values = random_field(5, (12, 13, 14))
    corners, cells = cells_of(values)
    dense = geometry.isosurface(values)
    below = (values.ravel()[cells] < 0).sum(axis=1)
    sparse = geometry.isosurface_of_cells(corners, values.ravel(), cells[(below > 0) & (below < 8)])
    assert is_closed_manifold(sparse)
    assert np.allclose(np.sort(dense[0], axis=0), np.sort(sparse[0], axis=0), atol=1e-12)
    assert len(dense[1]) == len(sparse[1])
    assert volume(sparse) == pytest.approx(volume(dense), rel=1e-12)


def test_any_number_of_threads_gives_the_same_bits() -> None:
    values = random_field(7, (40, 30, 66))
    corners, cells = cells_of(values)
    threads, results = torch.get_num_threads(), []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            results.append(
                geometry.isosurface(values)
                + geometry.isosurface_of_cells(corners, values.ravel(), cells)
            )
    finally:
        torch.set_num_threads(threads)
    for other in results[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(results[0], other))


def test_border_of_the_grid_is_open_and_nan_is_outside() -> None:
    open_report = mesh_report(Mesh(*_as_mesh(geometry.isosurface(grid(9)[..., 0] + 0.1))))
    assert open_report.boundaries == 1 and open_report.nonmanifold_edges == 0
    values = np.full((5, 5, 5), np.nan, np.float32)
    values[2, 2, 2] = -1
    assert is_closed_manifold(geometry.isosurface(values))


def _as_mesh(surface: Surface) -> tuple[NDArray, list]:
    return surface[0], surface[1].tolist()


def test_a_field_on_one_side_has_no_surface() -> None:
    for values in (np.ones((3, 3, 3)), -np.ones((3, 3, 3))):
        vertices, faces = geometry.isosurface(values)
        assert vertices.shape == (0, 3) and faces.shape == (0, 3)


def test_bad_grids_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        geometry.isosurface(np.zeros((4, 1, 4)))
    with pytest.raises(ValueError, match=r"\(X, Y, Z\)"):
        geometry.isosurface(np.zeros((4, 4)))
    with pytest.raises(ValueError, match="spacing"):
        geometry.isosurface(np.zeros((4, 4, 4)), spacing=(1, 0, 1))
    with pytest.raises(ValueError, match="rows of the 8 corners"):
        geometry.isosurface_of_cells(np.zeros((8, 3)), np.zeros(8), np.full((1, 8), 8))
