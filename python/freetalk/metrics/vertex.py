"""Metrics of vertex motion: prediction against ground truth, sequence by sequence, and of several samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from freetalk import _native
from freetalk.metrics._arrays import batched, flags, floats, mask

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array

MetricInfo = _native.metrics.MetricInfo

#: What every vertex metric measures, by name, in the order in which tables print them.
METRICS: dict[str, MetricInfo] = {info.name: info for info in _native.metrics.vertex_metrics()}

_ARGUMENTS = """
    p, g: displacements from the neutral face of prediction and ground truth, of vertex v at frame t;
    u, w: their steps from a frame to the next. Frames count that are valid, vertices that the mask holds.

    Args:
        pred: (B, T, V, 3) float, or (T, V, 3): displacements from the neutral face, in metres (or any
            unit; the result's follows).
        target: likewise.
        vertices: mask of the {mask}: (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (B, T) bool, or (T,): frames that count; ``None``: all.{more}

    Returns:
        (B,) float64, or () for a single sequence, {unit}.

    Raises:
        ValueError: shapes, mask or frames do not fit, with what was found.

    Source: {source}.
"""
_TARGET_VALID = """
        target_valid: (B, T') bool: the ground truth's own frames, which may differ in number."""
_MASKS = {"lips": "lips", "upper": "upper face", "all": "vertices"}


def metric_info(name: str) -> MetricInfo:
    """What a vertex metric measures: title, mask, unit, pooling, formula, source.

    Raises:
        ValueError: no such metric; names the nearest one.
    """
    return _native.metrics.metric_info(name)


def vertex_metric(
    name: str,
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
    fps: float = 0.0,
) -> torch.Tensor:
    """A metric of ``METRICS`` by its name.

    Args:
        name: such as ``lve``.
        pred: (B, T, V, 3) float, or (T, V, 3): displacements from the neutral face, m.
        target: likewise; DTW and DFD take another number of frames.
        vertices: mask, (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (B, T) bool, or (T,): frames that count; ``None``: all.
        target_valid: (B, T') bool: the ground truth's own, for DTW and DFD.
        fps: frames per second, for ``jerk_energy`` alone.

    Returns:
        (B,) float64, or () for a single sequence, in the unit that ``METRICS[name]`` states.

    Raises:
        ValueError: no such metric; shapes, mask or frames do not fit.
    """
    tensors, single = batched(
        floats(pred), floats(target), flags(valid), flags(target_valid), dims=4
    )
    result: torch.Tensor = _native.metrics.vertex_metric(
        name,
        tensors[0],
        tensors[1],
        vertices=mask(vertices),
        valid=tensors[2],
        target_valid=tensors[3],
        fps=fps,
    )
    return result[0] if single else result


def _metric(name: str) -> Callable[..., torch.Tensor]:
    """A metric of the registry as a function, with formula, unit and source as the registry states them."""

    def paired(
        pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
    ) -> torch.Tensor:
        return vertex_metric(name, pred, target, vertices=vertices, valid=valid)

    def warped(
        pred: Array,
        target: Array,
        *,
        vertices: Array | None = None,
        valid: Array | None = None,
        target_valid: Array | None = None,
    ) -> torch.Tensor:
        return vertex_metric(
            name, pred, target, vertices=vertices, valid=valid, target_valid=target_valid
        )

    info, warps = METRICS[name], name.startswith(("dtw", "dfd"))
    function = warped if warps else paired
    unit = "without unit" if info.unit == "1" else f"{info.unit} for motion in metres"
    more = _TARGET_VALID if warps else ""
    arguments = _ARGUMENTS.format(mask=_MASKS[info.mask], more=more, unit=unit, source=info.source)
    function.__doc__ = f"{info.title}: {info.formula}\n{arguments}"
    function.__name__ = function.__qualname__ = name
    return function


lve = _metric("lve")
"""Lip vertex error: the mean over frames of the greatest *squared* error of the lips."""
lve_l2 = _metric("lve_l2")
"""Lip vertex error, not squared."""
mve_mean = _metric("mve_mean")
"""Mean vertex error: what public code and the papers' tables call MVE."""
mve_max = _metric("mve_max")
"""Max vertex error: the MVE of FreeTalk's text."""
fdd = _metric("fdd")
"""Upper-face dynamic deviation, signed: above 0, the prediction moves too little."""
fdd_abs = _metric("fdd_abs")
"""Upper-face dynamic deviation without its sign."""
dtw = _metric("dtw")
"""Dynamic time warping of the lips' trajectories, per frame of the ground truth."""
dtw_sum = _metric("dtw_sum")
"""Dynamic time warping, summed along the path; grows with the length."""
dtw_vertex = _metric("dtw_vertex")
"""Dynamic time warping of each vertex by itself."""
dfd = _metric("dfd")
"""Discrete Fréchet distance of the lips' trajectories."""
dfd_vertex = _metric("dfd_vertex")
"""Discrete Fréchet distance of each vertex by itself."""
delta_m = _metric("delta_m")
"""Mean squared displacement error: squared difference of the steps from frame to frame."""
delta_m_l2 = _metric("delta_m_l2")
"""Displacement error, not squared."""
delta_cd = _metric("delta_cd")
"""Cosine displacement error, 0 to 2; 1 where one step alone is 0, about 1 where it is noise."""
delta_cd_weighted = _metric("delta_cd_weighted")
"""Cosine displacement error in which each step counts by its true length; 0 if nothing moves."""
jitter_ratio = _metric("jitter_ratio")
"""Jitter: the prediction's jerk energy over the ground truth's; 1 is equally smooth."""


def jerk_energy(
    motion: Array, fps: float, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Jerk energy of one motion: mean_t mean_v |m_(t+3) - 3 m_(t+2) + 3 m_(t+1) - m_t|^2 fps^6.

    Args:
        motion: (B, T, V, 3) float, or (T, V, 3), m.
        fps: frames per second.
        vertices: mask, (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (B, T) bool, or (T,): frames that count; ``None``: all.

    Returns:
        (B,) float64, or (), m^2/s^6.

    Raises:
        ValueError: shapes do not fit, or fewer than four valid frames in a row.
    """
    tensors, single = batched(floats(motion), flags(valid), dims=4)
    result: torch.Tensor = _native.metrics.jerk_energy(
        tensors[0], fps, vertices=mask(vertices), valid=tensors[1]
    )
    return result[0] if single else result


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
