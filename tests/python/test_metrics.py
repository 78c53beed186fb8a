"""Metrics against public implementations, plain numpy and closed forms."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable

import numpy as np
import pytest
import scipy.stats
import torch
from torchmetrics.functional.multimodal.lve import lip_vertex_error

from freetalk import metrics
from freetalk.evaluate.speech_motion import log_energy

# Metrics run in double precision; their oracles on the same numbers differ by rounding alone.
ROUNDING = 1e-9


def motions(seed: int, frames: int = 12, vertices: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Prediction and ground truth, (T, V, 3) m, a few millimetres."""
    rng = np.random.default_rng(seed)
    smooth = rng.normal(0, 0.003, (2, frames, vertices, 3)).cumsum(axis=1) / 3
    return smooth[0], smooth[1]


def warp(cost: np.ndarray, join: Callable[[float, float], float]) -> float:
    """Least cost over all paths, by enumeration."""
    rows, columns = cost.shape

    def best(i: int, j: int) -> float:
        if i == j == 0:
            return float(cost[0, 0])
        before = [best(a, b) for a, b in ((i - 1, j), (i, j - 1), (i - 1, j - 1)) if min(a, b) >= 0]
        return join(min(before), float(cost[i, j]))

    return best(rows - 1, columns - 1)


def test_lve_is_that_of_torchmetrics() -> None:
    pred, target = motions(0)
    lips = [3, 4, 7, 11]
    expected = lip_vertex_error(torch.tensor(pred), torch.tensor(target), lips)
    assert float(metrics.lve(pred, target, vertices=lips)) == pytest.approx(
        float(expected), rel=ROUNDING
    )


def test_frame_errors_are_those_of_public_code() -> None:
    pred, target = motions(1)
    lips = np.array([0, 5, 9])
    errors = np.linalg.norm(target - pred, axis=2)
    for name, expected in (
        ("lve", np.square(errors[:, lips]).max(axis=1).mean()),
        ("lve_l2", errors[:, lips].max(axis=1).mean()),
        ("mve_mean", errors[:, lips].mean()),
        ("mve_max", errors[:, lips].max(axis=1).mean()),
    ):
        found = float(metrics.vertex_metric(name, pred, target, vertices=lips))
        assert found == pytest.approx(expected, rel=ROUNDING), name


def test_fdd_is_the_published_loop() -> None:
    pred, target = motions(2)
    upper = [1, 2, 15]
    stds = [
        np.std(np.square(motion[:, upper]).sum(axis=2), axis=0).mean() for motion in (target, pred)
    ]
    assert float(metrics.fdd(pred, target, vertices=upper)) == pytest.approx(
        stds[0] - stds[1], rel=ROUNDING
    )
    assert float(metrics.fdd_abs(target, pred, vertices=upper)) == pytest.approx(
        abs(stds[0] - stds[1]), rel=ROUNDING
    )


@pytest.mark.parametrize("lengths", [(6, 6), (4, 7), (7, 3)])
def test_dtw_and_frechet_are_the_best_of_all_paths(lengths: tuple[int, int]) -> None:
    pred = motions(3, lengths[0], 3)[0]
    target = motions(4, lengths[1], 3)[1]
    cost = np.linalg.norm(pred[:, None] - target[None], axis=-1)  # (T, T', V)
    mean = cost.mean(axis=2)
    each = [cost[..., vertex] for vertex in range(3)]
    expected = {
        "dtw_sum": warp(mean, operator.add),
        "dtw": warp(mean, operator.add) / lengths[1],
        "dfd": warp(mean, max),
        "dtw_vertex": np.mean([warp(one, operator.add) for one in each]) / lengths[1],
        "dfd_vertex": np.mean([warp(one, max) for one in each]),
    }
    for name, value in expected.items():
        found = float(metrics.vertex_metric(name, pred, target))
        assert found == pytest.approx(value, rel=ROUNDING), name


def test_displacement_errors_are_their_formulas() -> None:
    pred, target = motions(5)
    u, w = np.diff(pred, axis=0), np.diff(target, axis=0)
    length = np.linalg.norm(w, axis=-1)
    cosine = (u * w).sum(-1) / np.linalg.norm(u, axis=-1) / length
    for name, expected in (
        ("delta_m", np.square(u - w).sum(-1).mean()),
        ("delta_m_l2", np.linalg.norm(u - w, axis=-1).mean()),
        ("delta_cd", (1 - cosine).mean()),
        ("delta_cd_weighted", (length * (1 - cosine)).sum() / length.sum()),
    ):
        found = float(metrics.vertex_metric(name, pred, target))
        assert found == pytest.approx(expected, rel=ROUNDING), name


def test_jerk_is_the_third_difference_over_time() -> None:
    pred, target = motions(6)
    energy = [np.square(25.0**3 * np.diff(m, n=3, axis=0)).sum(-1).mean() for m in (pred, target)]
    assert float(metrics.jerk_energy(pred, 25.0)) == pytest.approx(energy[0], rel=ROUNDING)
    assert float(metrics.jitter_ratio(pred, target)) == pytest.approx(
        energy[0] / energy[1], rel=ROUNDING
    )


def test_every_metric_says_what_it_is() -> None:
    for name, info in metrics.METRICS.items():
        assert info.formula and info.source and info.unit and info.title, name
        assert info.mask in ("lips", "upper", "all"), name
        assert info.pooling in ("frames", "sequences"), name
        documentation = getattr(metrics, name).__doc__
        assert "float" in documentation and "Raises" in documentation, name
        if name != "jerk_energy":
            assert info.formula in documentation and info.source in documentation, name


def test_arrays_and_batches_give_the_same_numbers() -> None:
    pred, target = motions(7)
    valid = np.arange(12) < 9
    single = metrics.delta_m(pred[:9], target[:9])
    batch = metrics.delta_m(
        torch.tensor(np.stack([pred, pred])),
        np.stack([target, target]),
        valid=np.stack([valid, valid]),
    )
    assert single.shape == () and batch.shape == (2,)
    # Sums over other shapes round in another order.
    assert batch.tolist() == pytest.approx([float(single)] * 2, rel=ROUNDING)
    flags = np.isin(np.arange(20), [2, 3])
    assert float(metrics.lve(pred, target, vertices=flags)) == float(
        metrics.lve(pred, target, vertices=[3, 2])
    )


def test_an_unknown_metric_names_the_nearest() -> None:
    with pytest.raises(ValueError, match="did you mean 'lve'"):
        metrics.metric_info("lvee")


def test_diversity_is_equation_twenty() -> None:
    codes = np.random.default_rng(8).normal(size=(3, 4, 5, 6))
    for audio, found in zip(codes, metrics.diversity(codes).tolist()):
        pairs = [np.linalg.norm(a - b) for a, b in itertools.permutations(audio, 2)]
        assert found == pytest.approx(sum(pairs) / 4, rel=ROUNDING)


def test_sample_scores_are_those_of_the_public_evaluations() -> None:
    target = motions(9)[1]
    samples = np.stack([motions(seed)[0] for seed in (10, 11, 12)])
    lips = [1, 4, 8]
    pairs = [np.linalg.norm(a - b, axis=2).mean() for a, b in itertools.combinations(samples, 2)]
    assert float(metrics.diversity_vertex(samples)) == pytest.approx(np.mean(pairs), rel=ROUNDING)

    def lve(motion: np.ndarray) -> float:
        return float(np.square(motion - target)[:, lips].sum(-1).max(axis=1).mean())

    assert float(metrics.lve_mean_estimate(samples, target, vertices=lips)) == pytest.approx(
        lve(samples.mean(axis=0)), rel=ROUNDING
    )
    assert float(metrics.lve_coverage(samples, target, vertices=lips)) == pytest.approx(
        min(map(lve, samples)), rel=ROUNDING
    )


def test_correlation_is_that_of_numpy() -> None:
    rng = np.random.default_rng(13)
    a, b = rng.normal(size=(2, 30))
    assert float(metrics.correlation(a, b)) == pytest.approx(
        float(np.corrcoef(a, b)[0, 1]), rel=ROUNDING
    )


def test_log_energy_is_its_formula() -> None:
    rng = np.random.default_rng(14)
    wave = rng.normal(0, 0.1, 4000).astype(np.float32)
    half = 533  # 16 kHz at 30 fps
    padded = np.pad(wave.astype(np.float64), (half, 2 * half))
    starts = np.round(np.arange(7) * 16000 / 30).astype(int)
    window = np.hanning(2 * half + 1)
    energy = np.array([np.square(padded[s : s + 2 * half + 1] * window).mean() for s in starts])
    expected = np.log(energy + 1e-6 * energy.max())
    found = metrics.log_energy(wave, 7, 30.0, 16000)
    np.testing.assert_allclose(found.numpy(), expected, rtol=ROUNDING)
    # Stored as float32: seven digits.
    np.testing.assert_allclose(log_energy(wave, 7, 30.0, 16000), expected, rtol=1e-6)


def test_best_offset_finds_whole_frames() -> None:
    rng = np.random.default_rng(15)
    leader = np.convolve(rng.normal(size=120), np.hanning(9), "same")
    for lag in (-4, 0, 3):
        found = metrics.best_offset(np.roll(leader, lag)[10:-10], leader[10:-10], 30.0)
        assert found.correlation == pytest.approx(1.0, abs=ROUNDING)
        # The parabola leaves a whole frame by the asymmetry of the correlation around it.
        assert found.offset_ms == pytest.approx(1000 * lag / 30, abs=0.1 * 1000 / 30)


def test_affect_features_are_mean_and_spread() -> None:
    motion = motions(16)[0]
    values = motion[:, [2, 5]].reshape(len(motion), -1)
    expected = np.concatenate([values.mean(axis=0), values.std(axis=0)])
    found = metrics.affect_features(motion, vertices=[2, 5])
    np.testing.assert_allclose(found.numpy(), expected, rtol=ROUNDING)


@pytest.mark.parametrize("count", [3, 9, 25, 60])
def test_wilcoxon_is_that_of_scipy(count: int) -> None:
    rng = np.random.default_rng(count)
    a, b = rng.normal(0.3, 1, count), rng.normal(0, 1, count)
    expected = scipy.stats.wilcoxon(a, b, method="exact")
    found = metrics.wilcoxon_test(a, b)
    assert found.statistic == expected.statistic
    assert found.p_value == pytest.approx(expected.pvalue, rel=ROUNDING)


def test_wilcoxon_with_ties_is_the_enumeration() -> None:
    differences = np.array([1.0, -1.0, 2.0, 2.0, -3.0, 0.0, 3.0, 4.0])
    kept = differences[differences != 0]
    ranks = scipy.stats.rankdata(np.abs(kept))
    sums = [
        ranks[np.array(signs) > 0].sum() for signs in itertools.product((-1, 1), repeat=len(kept))
    ]
    observed = min(ranks[kept > 0].sum(), ranks[kept < 0].sum())
    expected = 2 * np.mean(np.array(sums) <= observed)
    assert metrics.wilcoxon_test(differences, np.zeros(8)).p_value == pytest.approx(
        min(1.0, expected), rel=ROUNDING
    )


def test_many_pairs_are_approximated_as_scipy_does() -> None:
    rng = np.random.default_rng(17)
    a, b = np.round(rng.normal(0.1, 1, (2, 400)), 1)  # with ties
    kept = a != b
    expected = scipy.stats.wilcoxon(a[kept], b[kept], method="asymptotic").pvalue
    assert metrics.wilcoxon_test(a, b).p_value == pytest.approx(expected, rel=1e-6)


def test_permutation_test_is_that_of_scipy() -> None:
    rng = np.random.default_rng(18)
    a, b = rng.normal(0.4, 1, 10), rng.normal(0, 1, 10)
    expected = scipy.stats.permutation_test(
        (a, b), lambda x, y: np.mean(x - y), permutation_type="samples", n_resamples=np.inf
    )
    found = metrics.permutation_test(a, b, num_resamples=2000)
    assert found.statistic == pytest.approx(expected.statistic, rel=ROUNDING)
    assert found.p_value == pytest.approx(expected.pvalue, rel=ROUNDING)
    drawn = metrics.permutation_test(a, b, num_resamples=900)  # 2^10 are too many to enumerate
    # A share of 900 draws has a standard error of at most 0.017.
    assert drawn.p_value == pytest.approx(expected.pvalue, abs=0.06)


@pytest.mark.parametrize("method", ["percentile", "bca"])
def test_bootstrap_is_that_of_scipy(method: str) -> None:
    values = np.random.default_rng(19).gamma(2.0, 1.0, 25)  # skewed: the two methods differ
    name = "BCa" if method == "bca" else method
    expected = scipy.stats.bootstrap(
        (values,), np.mean, n_resamples=20000, method=name, rng=np.random.default_rng(1)
    ).confidence_interval
    options = metrics.BootstrapOptions(num_resamples=20000, method=method)
    found = metrics.bootstrap_mean(values, options=options, seed=3)
    assert found.mean == pytest.approx(values.mean(), rel=ROUNDING)
    # Quantiles of 20000 draws: 2.5 % of them is known to 0.1 %, about 0.02 standard errors of the mean.
    error = 0.06 * values.std() / np.sqrt(len(values))
    assert found.low == pytest.approx(expected.low, abs=error)
    assert found.high == pytest.approx(expected.high, abs=error)


def test_bootstrap_pools_frames() -> None:
    errors = [np.array([1.0, 2.0, 3.0]), np.array([10.0])]
    found = metrics.bootstrap_mean([e.mean() for e in errors], [len(e) for e in errors])
    assert found.mean == pytest.approx(np.concatenate(errors).mean(), rel=ROUNDING)


def test_bootstrap_options_are_checked() -> None:
    with pytest.raises(ValueError, match="bca or percentile"):
        metrics.BootstrapOptions(method="normal")
    with pytest.raises(ValueError, match="confidence"):
        metrics.BootstrapOptions(confidence=95.0)


def test_holm_is_step_down() -> None:
    assert metrics.holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
