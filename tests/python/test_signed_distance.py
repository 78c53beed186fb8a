"""Nearest points, winding numbers and signed distances against libigl and closed forms; holes closed."""

from __future__ import annotations

import igl
import numpy as np
import pytest
from numpy.typing import NDArray

from freetalk import geometry
from freetalk.mesh import Mesh, boundary_loops, close_holes, mesh_report


def ball(radius: float, center: tuple[float, float, float] = (0, 0, 0)) -> tuple[NDArray, NDArray]:
    """A sphere by marching cubes."""
    axis = np.linspace(-1, 1, 33)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    vertices, faces = geometry.isosurface(
        np.linalg.norm(places, axis=-1) - 0.8, origin=(-1, -1, -1), spacing=(1 / 16,) * 3
    )
    return vertices * radius / 0.8 + center, faces


def joined(*parts: tuple[NDArray, NDArray]) -> tuple[NDArray, NDArray]:
    firsts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + first for first, (_, faces) in zip(firsts, parts)]),
    )


@pytest.fixture(scope="module")
def points() -> NDArray:
    return np.random.default_rng(0).uniform(-1.2, 1.2, (2000, 3))


def test_nearest_points_are_those_of_libigl(points: NDArray) -> None:
    generator = np.random.default_rng(1)
    vertices = generator.normal(size=(300, 3))
    faces = generator.integers(0, 300, (700, 3)).astype(np.int32)  # a soup, degenerate ones in it
    faces[:20, 1] = faces[:20, 0]
    faces[20:25] = faces[20:25, :1]
    nearest, distances, of_faces = geometry.SurfaceTree(vertices, faces).nearest(points)
    squared, *_ = igl.point_mesh_squared_distance(points, vertices, faces)
    assert np.allclose(distances, np.sqrt(squared), atol=1e-9)
    assert np.allclose(np.linalg.norm(nearest - points, axis=1), distances, atol=1e-12)
    own = geometry.SurfaceTree(vertices, faces[of_faces[:1]]).nearest(points[:1])
    assert own[1][0] == pytest.approx(distances[0], abs=1e-12)


@pytest.mark.slow
def test_winding_numbers_are_those_of_libigl(points: NDArray) -> None:
    vertices, faces = joined(ball(0.6), ball(0.5, (0.5, 0, 0)))
    faces = faces[:-500]  # a hole
    tree = geometry.SurfaceTree(vertices, faces)
    exact = igl.winding_number(vertices, faces, points)
    assert np.allclose(tree.winding_number(points, accuracy=np.inf), exact, atol=1e-9)
    assert np.abs(tree.winding_number(points) - exact).max() < 0.1
    assert np.abs(tree.winding_number(points, accuracy=6) - exact).max() < 0.01


def test_sphere_has_its_signed_distance(points: NDArray) -> None:
    found = geometry.signed_distance(*ball(0.8), points)
    assert np.abs(found - (np.linalg.norm(points, axis=1) - 0.8)).max() < 2e-3


def test_parts_that_overlap_are_one_inside(points: NDArray) -> None:
    found = geometry.signed_distance(*joined(ball(0.6), ball(0.5, (0.5, 0, 0))), points)
    inside = (np.linalg.norm(points, axis=1) < 0.595) | (
        np.linalg.norm(points - [0.5, 0, 0], axis=1) < 0.495
    )
    outside = (np.linalg.norm(points, axis=1) > 0.605) & (
        np.linalg.norm(points - [0.5, 0, 0], axis=1) > 0.505
    )
    assert (found[inside] < 0).all() and (found[outside] > 0).all()


def test_bad_surfaces_and_points_are_refused() -> None:
    vertices, faces = ball(0.5)
    with pytest.raises(ValueError, match="faces"):
        geometry.SurfaceTree(vertices, faces[:0])
    with pytest.raises(ValueError, match="rows of"):
        geometry.SurfaceTree(vertices[:5], faces)
    with pytest.raises(ValueError, match="finite"):
        geometry.SurfaceTree(np.where(vertices > 0.4, np.nan, vertices), faces)
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        geometry.signed_distance(vertices, faces, np.zeros((4, 2)))
    with pytest.raises(ValueError, match="points must be finite"):
        geometry.signed_distance(vertices, faces, np.full((1, 3), np.nan))


def test_closed_holes_leave_a_closed_mesh() -> None:
    vertices, faces = ball(0.5)
    middles = vertices[faces].mean(axis=1)
    kept = faces[(middles[:, 0] < 0.3) & (middles[:, 1] < 0.45)]
    loops = boundary_loops(kept.tolist())
    assert len(loops) == 2
    closed = close_holes(vertices, kept)
    report = mesh_report(Mesh(closed[0], closed[1].tolist()))
    assert closed[2] == report.boundary_edges == report.inconsistent_edges == 0
    assert len(closed[0]) == len(vertices) + 2
    small = min(map(len, loops))
    partly = close_holes(vertices, kept, max_edges=small)
    assert partly[2] == sum(map(len, loops)) - small


def test_rims_that_touch_themselves_stay_open() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], float)
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    assert boundary_loops(faces.tolist()) == []
    assert close_holes(vertices, faces)[2] == 6
