"""Watertight heads: closed, with eyes and an open mouth, their samples true to the surface."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from freetalk.cli import main
from freetalk.corpus.heads import (
    PosedHead,
    draw_identity,
    draw_pairs,
    head_model,
    held_out_identities,
)
from freetalk.geometry import SurfaceTree
from freetalk.mesh import Mesh, load_mesh, mesh_report

MODEL = head_model()
REST = np.zeros(len(MODEL.expression_basis), np.float32)


def weights(**named: float) -> np.ndarray:
    return np.array([named.get(name, 0.0) for name in MODEL.expression_names], np.float32)


@pytest.fixture(scope="module")
def canonical() -> PosedHead:
    return PosedHead(MODEL, held_out_identities()[0], MODEL.canonical_weights)


def test_skin_and_balls_are_closed_and_turn_outward() -> None:
    vertices = MODEL.vertices(np.zeros(100), REST)
    report = mesh_report(Mesh(vertices, MODEL.faces.tolist()))
    assert report.parts == 3
    assert report.boundary_edges == report.nonmanifold_edges == report.inconsistent_edges == 0
    assert report.nonmanifold_vertices == report.unreferenced_vertices == 0
    a, b, c = vertices[MODEL.faces].transpose(1, 0, 2)
    assert 0.002 < np.einsum("fd,fd->", a, np.cross(b, c)) / 6 < 0.01  # m^3: a head and its neck


def test_inside_is_inside(canonical: PosedHead) -> None:
    mean = SurfaceTree(MODEL.vertices(np.zeros(100), MODEL.canonical_weights), MODEL.faces)
    brain, eye, air = [0, 0.06, -0.08], [0.0312, 0.0386, -0.0145], [0, 0, 0.2]
    mouth = [0, -0.036, 0.012]  # between the lips of the open mouth
    assert (
        np.sign(mean.signed_distance(np.array([brain, eye, air, mouth]))) == [-1, -1, 1, 1]
    ).all()


def test_lips_of_the_canonical_face_are_a_centimetre_apart() -> None:
    lips = [np.linalg.norm(MODEL.neutral - place, axis=1).argmin() for place in (
        [0, -0.0306, 0.0185], [0, -0.0314, 0.0182])]  # fmt: skip
    opened = MODEL.vertices(np.zeros(100), MODEL.canonical_weights)
    assert 0.007 < np.linalg.norm(opened[lips[0]] - opened[lips[1]]) < 0.013


def test_eyes_follow_the_identity_and_not_the_blink() -> None:
    skin = len(MODEL.neutral)
    rest = MODEL.vertices(np.zeros(100), REST)[skin:]
    assert np.array_equal(
        MODEL.vertices(np.zeros(100), weights(eyeBlink_L=1.0, eyeBlink_R=1.0))[skin:], rest
    )
    other = MODEL.vertices(held_out_identities()[1], REST)[skin:]
    assert np.linalg.norm(other - rest, axis=1).min() > 1e-5
    left, right = np.split(rest, 2)
    assert left[:, 0].mean() > 0.03 and right[:, 0].mean() < -0.03


def test_anchors_are_mirrored_pairs_spread_over_the_head() -> None:
    anchors = MODEL.neutral[MODEL.anchors]
    assert len(np.unique(MODEL.anchors)) == 39
    pairs = anchors[:32].reshape(16, 2, 3)
    assert np.abs(pairs[:, 0] * [-1, 1, 1] - pairs[:, 1]).max() < 0.004
    assert np.abs(anchors[32:, 0]).max() < 0.002
    nearest = np.linalg.norm(MODEL.neutral[:9409, None] - anchors, axis=-1).min(axis=1)
    assert nearest.max() < 0.11  # a head is 34 cm high


def test_drawn_points_lie_on_the_seen_surface(canonical: PosedHead) -> None:
    drawn = canonical.draw(np.random.default_rng(0), 2000, 0.7)
    assert 1000 < len(drawn.faces) < 2000  # most of a ball is within the head
    zero = np.zeros(len(drawn.faces))
    assert np.abs(canonical.signed_distance(canonical.place(drawn, zero))).max() < 1e-9
    outside = canonical.signed_distance(canonical.place(drawn, zero + 2e-4))
    assert (outside > 0).mean() > 0.99


def test_pairs_share_their_distance_and_never_cross_a_gap(canonical: PosedHead) -> None:
    posed = PosedHead(MODEL, held_out_identities()[0], REST)  # lips closed
    first, second = draw_pairs(canonical, posed, np.random.default_rng(1), 3000, 0.0025)
    assert len(first) == len(second) > 1000
    one, other = canonical.signed_distance(first), posed.signed_distance(second)
    assert np.abs(one - other).max() < 0.25 * np.abs(one).max()
    assert np.abs(one - other).mean() < 1e-4
    assert 1e-4 < np.linalg.norm(first - second, axis=1).mean() < 0.02


def test_held_out_identities_are_fixed_and_within_bounds() -> None:
    assert np.array_equal(held_out_identities(), held_out_identities())
    drawn = draw_identity(np.random.default_rng(0))
    assert drawn.shape == (100,) and np.abs(drawn).max() <= 2.5
    assert len(held_out_identities()) == 32 and not np.array_equal(drawn, held_out_identities()[0])


def test_heads_are_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["corpus", "heads", "--out", str(tmp_path / "heads")]
    assert main([*out, "--count", "2", "--held-out", "--expression", "jawOpen=0.4"]) == 0
    files = sorted((tmp_path / "heads").glob("*.ply"))
    assert [file.name for file in files] == ["head_000.ply", "head_001.ply"]
    expected = MODEL.vertices(held_out_identities()[1], weights(jawOpen=0.4))
    assert np.allclose(load_mesh(files[1]).vertices, expected, atol=1e-6)
    assert main([*out, "--expression", "grin=1"]) == 2
    assert "unknown expression 'grin'" in capsys.readouterr().err
