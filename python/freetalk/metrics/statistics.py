"""Confidence intervals and paired tests over the sequences of a test set."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from freetalk import _native
from freetalk.metrics._arrays import floats

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array

BootstrapOptions = _native.metrics.BootstrapOptions
Interval = _native.metrics.Interval
PairedTest = _native.metrics.PairedTest


def bootstrap_mean(
    values: Array,
    weights: Array | None = None,
    *,
    options: BootstrapOptions | None = None,
    seed: int = 0,
) -> Interval:
    """Weighted mean sum w x / sum w over sequences, and its bootstrap confidence interval.

    Sequences are drawn with replacement. ``options.method`` is ``bca``, bias-corrected and accelerated
    [Efron 1987], or ``percentile``.

    Args:
        values: (N,) float, one number a sequence.
        weights: (N,) float above 0, such as frames; ``None``: all 1.
        options: resamples (10,000), confidence (0.95) and method.
        seed: same seed, same interval.

    Returns:
        ``mean``, ``low`` and ``high``; one sequence has no interval: NaN.

    Raises:
        ValueError: lengths differ, or a value is not finite.
    """
    return _native.metrics.bootstrap_mean(
        floats(values),
        None if weights is None else floats(weights),
        options=options or BootstrapOptions(),
        seed=seed,
    )


def permutation_test(
    a: Array,
    b: Array,
    weights: Array | None = None,
    *,
    num_resamples: int = 10000,
    seed: int = 0,
) -> PairedTest:
    """Sign-flip permutation test of the weighted mean difference of paired sequences, two-sided.

    Exact where 2^N <= ``num_resamples``, else Monte Carlo with p = (1 + hits) / (1 + resamples).

    Args:
        a: (N,) float.
        b: (N,) float of the same sequences.
        weights: (N,) float above 0; ``None``: all 1.
        num_resamples: sign patterns drawn.
        seed: same seed, same p-value.

    Returns:
        ``statistic``, the mean of a - b, and ``p_value``.

    Raises:
        ValueError: lengths differ, or a value is not finite.
    """
    return _native.metrics.permutation_test(
        floats(a),
        floats(b),
        weights=None if weights is None else floats(weights),
        num_resamples=num_resamples,
        seed=seed,
    )


def wilcoxon_test(a: Array, b: Array) -> PairedTest:
    """Wilcoxon's signed-rank test of paired sequences, two-sided [Wilcoxon 1945].

    Pairs without a difference are dropped, ties share their mean rank. Exact up to 200 pairs, ties
    included, else the normal approximation with tie correction.

    Args:
        a: (N,) float.
        b: (N,) float of the same sequences.

    Returns:
        ``statistic``, the smaller rank sum, and ``p_value``.

    Raises:
        ValueError: lengths differ, or a value is not finite.
    """
    return _native.metrics.wilcoxon_test(floats(a), floats(b))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values corrected for their number, in their order [Holm 1979].

    Raises:
        ValueError: a value outside [0, 1].
    """
    return list(_native.metrics.holm([float(p) for p in p_values]))
