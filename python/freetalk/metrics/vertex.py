"""Metrics of vertex motion: prediction against ground truth, sequence by sequence."""

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


def _documented(function: Callable[..., torch.Tensor]) -> Callable[..., torch.Tensor]:
    """Completes a docstring with formula, unit and source as the registry states them."""
    info = METRICS[function.__name__]
    more = _TARGET_VALID if "target_valid" in function.__annotations__ else ""
    unit = "without unit" if info.unit == "1" else f"{info.unit} for motion in metres"
    arguments = _ARGUMENTS.format(mask=_MASKS[info.mask], more=more, unit=unit, source=info.source)
    function.__doc__ = f"{function.__doc__}\n\n    {info.formula}\n{arguments}"
    return function


@_documented
def lve(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Lip vertex error: the mean over frames of the greatest *squared* error of the lips."""
    return vertex_metric("lve", pred, target, vertices=vertices, valid=valid)


@_documented
def lve_l2(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Lip vertex error, not squared."""
    return vertex_metric("lve_l2", pred, target, vertices=vertices, valid=valid)


@_documented
def mve_mean(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Mean vertex error: what public code and the papers' tables call MVE."""
    return vertex_metric("mve_mean", pred, target, vertices=vertices, valid=valid)


@_documented
def mve_max(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Max vertex error: the MVE of FreeTalk's text."""
    return vertex_metric("mve_max", pred, target, vertices=vertices, valid=valid)


@_documented
def fdd(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Upper-face dynamic deviation, signed: above 0, the prediction moves too little."""
    return vertex_metric("fdd", pred, target, vertices=vertices, valid=valid)


@_documented
def fdd_abs(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Upper-face dynamic deviation without its sign."""
    return vertex_metric("fdd_abs", pred, target, vertices=vertices, valid=valid)


@_documented
def dtw(
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
) -> torch.Tensor:
    """Dynamic time warping of the lips' trajectories, per frame of the ground truth."""
    return vertex_metric(
        "dtw", pred, target, vertices=vertices, valid=valid, target_valid=target_valid
    )


@_documented
def dtw_sum(
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
) -> torch.Tensor:
    """Dynamic time warping, summed along the path; grows with the length."""
    return vertex_metric(
        "dtw_sum", pred, target, vertices=vertices, valid=valid, target_valid=target_valid
    )


@_documented
def dtw_vertex(
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
) -> torch.Tensor:
    """Dynamic time warping of each vertex by itself."""
    return vertex_metric(
        "dtw_vertex", pred, target, vertices=vertices, valid=valid, target_valid=target_valid
    )


@_documented
def dfd(
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
) -> torch.Tensor:
    """Discrete Fréchet distance of the lips' trajectories."""
    return vertex_metric(
        "dfd", pred, target, vertices=vertices, valid=valid, target_valid=target_valid
    )


@_documented
def dfd_vertex(
    pred: Array,
    target: Array,
    *,
    vertices: Array | None = None,
    valid: Array | None = None,
    target_valid: Array | None = None,
) -> torch.Tensor:
    """Discrete Fréchet distance of each vertex by itself."""
    return vertex_metric(
        "dfd_vertex", pred, target, vertices=vertices, valid=valid, target_valid=target_valid
    )


@_documented
def delta_m(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Mean squared displacement error: squared difference of the steps from frame to frame."""
    return vertex_metric("delta_m", pred, target, vertices=vertices, valid=valid)


@_documented
def delta_m_l2(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Displacement error, not squared."""
    return vertex_metric("delta_m_l2", pred, target, vertices=vertices, valid=valid)


@_documented
def delta_cd(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Cosine displacement error, 0 to 2; 1 where one step alone is 0, about 1 where it is noise."""
    return vertex_metric("delta_cd", pred, target, vertices=vertices, valid=valid)


@_documented
def delta_cd_weighted(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Cosine displacement error in which each step counts by its true length; 0 if nothing moves."""
    return vertex_metric("delta_cd_weighted", pred, target, vertices=vertices, valid=valid)


@_documented
def jitter_ratio(
    pred: Array, target: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Jitter: the prediction's jerk energy over the ground truth's; 1 is equally smooth."""
    return vertex_metric("jitter_ratio", pred, target, vertices=vertices, valid=valid)


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
