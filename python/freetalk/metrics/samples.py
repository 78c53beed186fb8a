"""Scores of several samples that were generated for the same audio."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from freetalk import _native
from freetalk.metrics._arrays import batched, flags, floats, mask

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array


def diversity(codes: Array) -> torch.Tensor:
    """Diversity of generated codes: D_i = 1/K sum_j sum_(l != j) |e_ij - e_il|_2 [FaceTalk Eq. 20].

    The paper's D is the mean over the N audio signals. It grows with K and with the length of the
    codes, so compare equal ones only.

    Args:
        codes: (N, K, ...) float, K >= 2 samples for each audio; the norm runs over the rest.

    Returns:
        (N,) float64, the codes' unit.

    Raises:
        ValueError: fewer than two samples.
    """
    return _native.metrics.diversity(floats(codes))


def diversity_vertex(
    samples: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Mean over pairs of samples, frames and vertices of |p_jtv - p_ltv| [FaceDiffuser's evaluation].

    Args:
        samples: (N, K, T, V, 3) float, or (K, T, V, 3), m, K >= 2.
        vertices: mask, (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (N, T) bool, or (T,): frames that count; ``None``: all.

    Returns:
        (N,) float64, or (), m.

    Raises:
        ValueError: shapes do not fit, or fewer than two samples.
    """
    return _scored(_native.metrics.diversity_vertex, samples, vertices=vertices, valid=valid)


def lve_mean_estimate(
    samples: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Mean estimate error: the LVE of the mean of the samples [ProbTalk3D].

    Args:
        samples: (N, K, T, V, 3) float, or (K, T, V, 3), m.
        target: (N, T, V, 3), or (T, V, 3).
        vertices: mask of the lips, (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (N, T) bool, or (T,): frames that count; ``None``: all.

    Returns:
        (N,) float64, or (), m^2.

    Raises:
        ValueError: shapes do not fit.
    """
    return _scored(
        _native.metrics.lve_mean_estimate, samples, target, vertices=vertices, valid=valid
    )


def lve_coverage(
    samples: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Coverage error: the least LVE of the samples [ProbTalk3D]; arguments as `lve_mean_estimate`.

    Returns:
        (N,) float64, or (), m^2.

    Raises:
        ValueError: shapes do not fit.
    """
    return _scored(_native.metrics.lve_coverage, samples, target, vertices=vertices, valid=valid)


def _scored(
    metric: Callable[..., torch.Tensor],
    *motions: Array,
    vertices: Array | None,
    valid: Array | None,
) -> torch.Tensor:
    """Calls a metric of the native room on motions, the first of them (N, K, T, V, 3) or one less."""
    tensors, single = batched(*map(floats, motions), flags(valid), dims=5)
    result = metric(*tensors[:-1], vertices=mask(vertices), valid=tensors[-1])
    return result[0] if single else result
