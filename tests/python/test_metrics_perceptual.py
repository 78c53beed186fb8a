"""Timing and intensity of lips against the published code's steps, and distances of other meshings."""

from __future__ import annotations

import math

import igl
import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

from freetalk import metrics
from freetalk.evaluate import surface_distances, surface_scores


def opening(frames: int, seed: int) -> np.ndarray:
    """A lip opening (T,) of a few speeds, m."""
    rng = np.random.default_rng(seed)
    times = np.arange(frames)[:, None] / 30
    waves = np.sin(2 * np.pi * rng.uniform(1, 5, 4) * times + rng.uniform(0, 6, 4))
    return 0.01 * np.square(waves @ rng.uniform(0.2, 1, 4))


def published(pred: np.ndarray, true: np.ndarray, fps: float) -> float:
    """MTM as the paper's code takes it, with SciPy's smoothing and peaks, in ms."""
    smooth = [gaussian_filter1d(x, sigma=2.0) for x in (true, pred)]
    steps = [np.diff(x, prepend=x[0]) for x in smooth]
    n, m = map(len, steps)
    total = np.full((n + 1, m + 1), np.inf)
    total[0, 0] = 0
    for i in range(n):
        for j in range(m):
            before = min(total[i, j + 1], total[i + 1, j], total[i, j])
            total[i + 1, j + 1] = abs(steps[0][i] - steps[1][j]) + before
    kinds = []
    for series in smooth:
        kinds.append(dict.fromkeys(find_peaks(series)[0].tolist(), "max"))
        kinds[-1].update(dict.fromkeys(find_peaks(-series)[0].tolist(), "min"))
    bends = sorted(kinds[0])
    i, j, found = n, m, []
    while i > 0 and j > 0:
        at = (i - 1, j - 1)
        if at[0] in kinds[0] and kinds[0][at[0]] == kinds[1].get(at[1]):
            place = bends.index(at[0])
            low = bends[place - 1] if place else 0
            high = bends[place + 1] if place + 1 < len(bends) else n - 1
            if low <= at[1] <= high:
                found.append(abs(at[0] - at[1]))
        step = np.argmin([total[i - 1, j - 1], total[i - 1, j], total[i, j - 1]])
        i, j = [(i - 1, j - 1), (i - 1, j), (i, j - 1)][step]
    return 1000 * float(np.mean(found)) / fps if found else math.nan


@pytest.mark.parametrize("seed", range(5))
def test_misalignment_is_that_of_the_published_steps(seed: int) -> None:
    true, pred = opening(90, seed), opening(90, seed) + 0.2 * opening(90, 50 + seed)
    found = metrics.temporal_misalignment(pred, true, 30.0)
    # Frames are whole, so the same joins give the same number but for the mean's rounding.
    assert found == pytest.approx(published(pred, true, 30.0), rel=1e-12)


def test_a_late_prediction_is_misaligned_by_its_delay() -> None:
    true = opening(200, 1)
    assert metrics.temporal_misalignment(true, true, 30.0) == 0
    late = np.concatenate([np.full(3, true[0]), true[:-3]])
    # Three frames at 30 fps; at the ends the warping may join otherwise.
    assert metrics.temporal_misalignment(late, true, 30.0) == pytest.approx(100, abs=15)
    # The same motion at twice the rate: smoothing and delay are in seconds.
    double = np.interp(np.arange(0, 199.5, 0.5), np.arange(200), true)
    held = np.concatenate([np.full(6, double[0]), double[:-6]])
    assert metrics.temporal_misalignment(held, double, 60.0) == pytest.approx(100, abs=15)


def test_still_lips_have_no_misalignment() -> None:
    assert math.isnan(metrics.temporal_misalignment(np.zeros(50), opening(50, 0), 30.0))
    with pytest.raises(ValueError, match="0 fps"):
        metrics.temporal_misalignment(np.ones(5), np.ones(5), 0)


def test_lip_intensity_is_the_root_mean_square_of_the_mean_step() -> None:
    rng = np.random.default_rng(0)
    motion, lips = rng.normal(size=(20, 9, 3)), [1, 4, 7]
    steps = np.linalg.norm(np.diff(motion[:, lips], axis=0), axis=-1).mean(axis=1)
    expected = np.sqrt(np.square(steps).mean())
    # float64 throughout.
    assert metrics.lip_intensity(motion, vertices=lips) == pytest.approx(expected, rel=1e-12)
    flags = torch.zeros(9, dtype=torch.bool)
    flags[lips] = True
    assert metrics.lip_intensity(motion, vertices=flags) == pytest.approx(expected, rel=1e-12)
    assert metrics.speech_intensity(np.array([3.0, -4.0])) == pytest.approx(np.sqrt(12.5))


def test_intensities_correlate_within_speakers_not_between_them() -> None:
    rng = np.random.default_rng(1)
    speakers = ["a"] * 20 + ["b"] * 20 + ["alone"]
    speech = rng.normal(size=41)
    lips = 0.6 * speech + 0.8 * rng.normal(size=41)
    lips[20:40] = 100 + 7 * lips[20:40]  # another face, another unit: no matter
    found = metrics.speech_lip_correlation(speech, lips, speakers)
    normal = [
        np.concatenate([(x - x.mean()) / x.std(ddof=1) for x in (values[:20], values[20:40])])
        for values in (speech, lips)
    ]
    assert found.value == pytest.approx(np.corrcoef(*normal)[0, 1], rel=1e-12)
    assert math.isnan(found.shares[40])  # one clip has no spread
    assert np.nanmean(found.shares) == pytest.approx(found.value, rel=1e-12)
    with pytest.raises(ValueError, match="2, 1 intensities of 2"):
        metrics.speech_lip_correlation([1.0, 2.0], [1.0], ["a", "b"])


def dome(side: int, lift: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(-0.07, 0.07, side), np.linspace(-0.09, 0.09, side))
    vertices = np.stack([x, y, 0.04 - 4 * x**2 - 2 * y**2 + lift], axis=-1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    first = np.stack([corner, corner + 1, corner + side], axis=1)
    second = np.stack([corner + 1, corner + side + 1, corner + side], axis=1)
    return vertices, np.concatenate([first, second])


def test_distances_of_other_meshings_are_those_of_libigl() -> None:
    (a, a_faces), (b, b_faces) = dome(12), dome(17, 0.002)
    found = surface_distances(a[None], a_faces, b[None], b_faces)
    squared = [
        igl.point_mesh_squared_distance(p, v, f)[0]
        for p, v, f in ((a, b, b_faces), (b, a, a_faces))
    ]
    one, other = (np.sqrt(np.asarray(own)) for own in squared)
    assert found.point_to_surface[0] == pytest.approx((one.mean() + other.mean()) / 2, rel=1e-6)
    assert found.hausdorff[0] == pytest.approx(max(one.max(), other.max()), rel=1e-6)
    gaps = np.linalg.norm(a[:, None] - b[None], axis=-1)
    chamfer = np.square(gaps.min(axis=1)).mean() + np.square(gaps.min(axis=0)).mean()
    assert found.chamfer[0] == pytest.approx(chamfer, rel=1e-9)


def test_finer_meshings_of_one_surface_come_together() -> None:
    coarse, fine, finest = dome(9), dome(33), dome(65)
    distances = [
        surface_distances(one[0][None], one[1], finest[0][None], finest[1])
        for one in (coarse, fine, finest)
    ]
    mean = [own.point_to_surface[0] for own in distances]
    assert (
        mean[0] > 8 * mean[1] > 0
    )  # flat triangles of a quarter the side: a sixteenth of the error
    # A surface and itself: what float64 leaves of positions of 0.1 m.
    assert mean[2] < 1e-12 and distances[2].hausdorff[0] < 1e-12 and distances[2].chamfer[0] == 0


def test_frames_and_shapes_of_surfaces_must_fit() -> None:
    vertices, faces = dome(5)
    with pytest.raises(ValueError, match="2 frames against 1"):
        surface_distances(np.stack([vertices] * 2), faces, vertices[None], faces)
    with pytest.raises(ValueError, match=r"pred is \(25, 3\)"):
        surface_distances(vertices, faces, vertices[None], faces)


def test_a_shifted_surface_scores_its_shift() -> None:
    plane = dome(3)
    flat = plane[0] * [1, 1, 0], plane[1]
    scores = surface_scores(
        (flat[0] + [0, 0, 0.002], flat[1]), flat, thresholds=(0.001, 0.003), num_points=20_000
    )
    assert scores.point_to_surface == pytest.approx(0.002)
    assert 0.002 < scores.chamfer_l1 < 0.0023
    assert scores.normal_consistency == pytest.approx(1)
    assert scores.f_scores[0.001] == 0 and scores.f_scores[0.003] > 0.99
    same = surface_scores(flat, flat, thresholds=(0.001,), num_points=20_000)
    # Samples of other seeds: the distance to the nearest one varies by their pattern.
    assert same.chamfer_l1 == pytest.approx(same.sampling_floor, rel=0.3)
    assert same.sampling_floor > 0


def test_scores_may_count_a_part_of_the_surface() -> None:
    flat = dome(3)[0] * [1, 1, 0], dome(3)[1]
    bent = flat[0] + np.where(flat[0][:, :1] > 0.01, 0.01, 0) * [0, 0, 1], flat[1]
    left = surface_scores(
        bent, flat, thresholds=(1e-6,), num_points=5000, keep=lambda p: p[:, 0] < -0.005
    )
    assert left.point_to_surface < 1e-12
    with pytest.raises(ValueError, match="no point of the surface counts"):
        surface_scores(flat, flat, thresholds=(1.0,), keep=lambda p: p[:, 0] > 1)
