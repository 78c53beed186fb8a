"""The corpus's meshings: on the surface, exact linear models, lips that open, masks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from freetalk.corpus import assets, topologies

MODEL = assets.load_face_model()
JAW = MODEL.expression_basis[MODEL.index("jawOpen")].astype(np.float64)


@pytest.fixture(scope="module", params=topologies.TOPOLOGIES, ids=lambda spec: spec.name)
def case(request: pytest.FixtureRequest) -> tuple[topologies.TopologySpec, topologies.Meshing]:
    return request.param, request.param.build(MODEL)


def test_carry_is_barycentric(case: tuple[topologies.TopologySpec, topologies.Meshing]) -> None:
    _, meshing = case
    sums = np.asarray(meshing.carry.sum(axis=1)).ravel()
    np.testing.assert_allclose(sums, 1, atol=1e-9)
    assert meshing.carry.min() >= 0
    assert set(np.unique(meshing.faces)) == set(range(meshing.carry.shape[0]))


def test_surface_stays_near_the_source(
    case: tuple[topologies.TopologySpec, topologies.Meshing],
) -> None:
    spec, meshing = case
    points = meshing.carry @ MODEL.neutral.astype(np.float64)
    near = np.flatnonzero(MODEL.neutral[: assets.EXTENTS["narrow"], 2] > 0)
    centres = points[meshing.faces].mean(axis=1)
    samples = np.concatenate([points, centres])
    distance, _ = cKDTree(MODEL.neutral[: assets.EXTENTS["sockets"]]).query(samples)
    assert distance.max() < 0.012  # metres: the source's own vertices are up to 8 mm apart
    covered, _ = cKDTree(samples).query(MODEL.neutral[near])
    assert np.median(covered) < 0.005, spec.name


def test_lips_open_without_bridges(
    case: tuple[topologies.TopologySpec, topologies.Meshing],
) -> None:
    _, meshing = case
    points = meshing.carry @ MODEL.neutral.astype(np.float64)
    motion = (meshing.carry @ JAW)[:, 1]
    lips = MODEL.neutral[MODEL.landmarks68[48:68]]
    distance, _ = cKDTree(lips).query(points)
    middle = (distance < 0.010) & (np.abs(points[:, 0]) < 0.012)
    edges = meshing.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = edges[middle[edges].all(axis=1)]
    # The jaw opens the lips by 3.3 cm; an edge from lip to lip would stretch by about that much.
    assert np.abs(motion[edges[:, 0]] - motion[edges[:, 1]]).max() < 0.016
    assert motion[middle].min() < -0.028 and motion[middle].max() > -0.008


def test_masks_are_disjoint_and_present() -> None:
    for name in topologies.TINY_TOPOLOGIES:
        spec = next(s for s in topologies.TOPOLOGIES if s.name == name)
        arrays = topologies.topology_arrays(MODEL, spec, 0)
        assert arrays["lip_mask"].sum() > 20 and arrays["upper_face_mask"].sum() > 100
        assert not (arrays["lip_mask"] & arrays["upper_face_mask"]).any()
        assert arrays["expression_basis"].shape == (57, len(arrays["neutral"]), 3)
        assert arrays["identity_basis"].shape == (100, len(arrays["neutral"]), 3)


def test_test_meshings_are_not_train_meshings() -> None:
    by_split: dict[str, set[str]] = {}
    for spec in topologies.TOPOLOGIES:
        by_split.setdefault(spec.split, set()).add(spec.name)
    assert len(by_split["train"]) >= 5 and len(by_split["test"]) >= 3
    assert not by_split["train"] & by_split["test"]
