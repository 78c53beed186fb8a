"""Fréchet and kernel distances: closed forms, and torchmetrics on the same features."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torchmetrics.image.fid import _compute_fid
from torchmetrics.image.kid import poly_mmd

from freetalk.evaluate.generated import (
    features_of,
    frechet_distance,
    kernel_distance,
)


def test_frechet_distance_is_that_of_torchmetrics() -> None:
    rng = np.random.default_rng(1)
    first, second = rng.normal(size=(200, 8)), rng.normal(0.3, 1.4, size=(150, 8))
    expected = _compute_fid(
        *(torch.from_numpy(v) for x in (first, second) for v in (x.mean(0), np.cov(x.T)))
    )
    assert frechet_distance(first, second) == pytest.approx(float(expected), rel=1e-6)
    assert frechet_distance(first, first) == pytest.approx(0, abs=1e-9)
    assert frechet_distance(first, first + 2) == pytest.approx(8 * 4)


def test_frechet_distance_of_few_rows_is_finite() -> None:
    rows = np.random.default_rng(2).normal(size=(5, 100))
    assert frechet_distance(rows, rows + 1) == pytest.approx(100)


def test_kernel_distance_is_that_of_torchmetrics() -> None:
    rng = np.random.default_rng(3)
    first, second = rng.normal(size=(60, 8)), rng.normal(0.5, 1.0, size=(60, 8))
    expected = poly_mmd(torch.from_numpy(first), torch.from_numpy(second), 3, None, 1.0)
    assert kernel_distance(first, second) == pytest.approx(float(expected), rel=1e-9)


def test_features_are_taken_a_batch_at_a_time() -> None:
    seen = []

    def network(pictures: list) -> np.ndarray:
        seen.append(len(pictures))
        return np.array([[p.mean(), p.max()] for p in pictures])

    pictures = [np.full((2, 2, 3), n, np.uint8) for n in range(7)]
    found = features_of(iter(pictures), network, batch=3)
    assert seen == [3, 3, 1]
    assert np.array_equal(found[:, 0], np.arange(7))


def test_bad_features_and_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 2 rows"):
        frechet_distance(np.zeros((1, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="at least 2 rows"):
        kernel_distance(np.zeros((5, 3)), np.zeros((4, 2)))
    with pytest.raises(ValueError, match="no pictures"):
        features_of([], lambda pictures: np.zeros((len(pictures), 2)))
    with pytest.raises(ValueError, match="shape"):
        features_of([np.zeros((1, 1, 3), np.uint8)], lambda pictures: np.zeros(3))
