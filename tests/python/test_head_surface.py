"""Extracted surfaces of a head: those of the dense grid, closed, and alike in a sequence."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from test_head_fit import ball, codes
from torch import Tensor

from freetalk.geometry import isosurface
from freetalk.head import (
    ParametricHead,
    PreparedHead,
    SmoothingOptions,
    Surface,
    SurfaceExtractor,
    SurfaceOptions,
    extract,
)

SMALL = SurfaceOptions(resolution=64, coarse=8)


@pytest.fixture(scope="module")
def trained() -> ParametricHead:
    return ball()


def assert_closed(surface: Surface) -> None:
    """Every edge belongs to two triangles that pass it in opposite directions."""
    edges = np.concatenate([surface.faces[:, [a, (a + 1) % 3]] for a in range(3)])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert {(b, a) for a, b in directed} == directed


def dense_grid(head: PreparedHead, z_exp: Tensor, cells: int) -> np.ndarray:
    low, high = head.options.box_min, head.options.box_max
    axes = [torch.linspace(a, b, cells + 1) for a, b in zip(low, high, strict=True)]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    moved = head.to_canonical(points, z_exp)
    return head.canonical_sdf(moved, fade=False).reshape([cells + 1] * 3).numpy()


@pytest.mark.slow
def test_surfaces_are_those_of_the_dense_grid(trained: ParametricHead) -> None:
    """The main part: parts apart from it may be left out where they are smaller than a cell in between."""
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    options = SurfaceOptions(resolution=64, coarse=8, at_box="open")
    sparse = extract(head, z_exp[0], options=options)
    spacing = [(b - a) / 64 / 4 for a, b in zip(head.options.box_min, head.options.box_max, strict=True)]  # fmt: skip
    origin = [a / 4 for a in head.options.box_min]
    dense = isosurface(dense_grid(head, z_exp[0], 64), origin=origin, spacing=spacing)
    dense_points = {tuple(p) for p in np.round(np.asarray(dense[0]), 6).tolist()}
    found = {tuple(p) for p in np.round(sparse.vertices, 6).tolist()}
    assert len(found & dense_points) > 0.98 * len(found)
    assert len(found & dense_points) > 0.9 * len(dense_points)
    assert sparse.num_evaluations < 0.35 * 65**3


@pytest.mark.slow
def test_two_hundred_codes_give_closed_surfaces(trained: ParametricHead) -> None:
    z_id, _ = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    extractor = SurfaceExtractor(head, SurfaceOptions(resolution=32, coarse=8))
    generator = torch.Generator().manual_seed(2)
    for z_exp in 0.5 * torch.randn(200, trained.options.expression_dim, generator=generator):
        assert_closed(extractor.next(z_exp))


@pytest.mark.slow
def test_frames_of_a_sequence_equal_frames_alone(trained: ParametricHead) -> None:
    """Up to the interpolation of canonical distances, a hundredth of a cell."""
    z_id, z_exp = codes(trained, 4)
    head = PreparedHead(trained, z_id)
    whole = SurfaceExtractor(head, SurfaceOptions(resolution=64, coarse=8, canonical_grid=False))
    quick = SurfaceExtractor(head, SMALL)
    for own in z_exp:
        alone, next_one, interpolated = extract(head, own, options=SMALL), whole.next(own), quick.next(own)  # fmt: skip
        assert np.array_equal(alone.vertices, next_one.vertices)
        assert np.array_equal(alone.faces, next_one.faces)
        assert_closed(interpolated)
        if len(interpolated.vertices) == len(alone.vertices):
            assert np.abs(interpolated.vertices - alone.vertices).mean() < 2e-5


@pytest.mark.slow
def test_surfaces_that_leave_the_box_are_closed_or_refused(trained: ParametricHead) -> None:
    options = trained.options
    options.box_max = [0.55, 0.75, 0.1]  # through the ball
    cut = ParametricHead(options).eval()
    cut.load_state_dict(trained.state_dict())
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(cut, z_id)
    assert_closed(extract(head, z_exp[0], options=SMALL))
    with pytest.raises(RuntimeError, match="leaves the head's box"):
        extract(head, z_exp[0], options=SurfaceOptions(resolution=64, coarse=8, at_box="error"))
    with pytest.raises(AssertionError):
        assert_closed(
            extract(head, z_exp[0], options=SurfaceOptions(resolution=64, coarse=8, at_box="open"))
        )


@pytest.mark.slow
def test_smoothing_moves_the_surface_to_rest_away_from_the_face(trained: ParametricHead) -> None:
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    nothing = SmoothingOptions(mode="rest", center=[0, 0, 9.0], sigma=[0.1, 0.1, 0.1])
    smoothed = extract(head, z_exp[0], options=SMALL, smoothing=nothing)
    rest = extract(head, trained.state_dict()["rest_expression"], options=SMALL)
    assert smoothed.vertices.shape == rest.vertices.shape
    assert np.abs(smoothed.vertices - rest.vertices).max() < 1e-5


def test_options_and_codes_are_checked(trained: ParametricHead) -> None:
    z_id, z_exp = codes(trained, 1)
    head = PreparedHead(trained, z_id)
    with pytest.raises(ValueError, match="multiple"):
        SurfaceExtractor(head, SurfaceOptions(resolution=60, coarse=32))
    with pytest.raises(ValueError, match="finite"):
        extract(head, z_exp[0] * float("nan"), options=SMALL)
