"""What lips do with speech: how far they open, whether they close where they must, how late they are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, NamedTuple

import torch

from freetalk import _native
from freetalk.metrics._arrays import batched, flags, floats

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array

#: Phones that need closed lips.
BILABIALS = ("P", "B", "M")


class Offset(NamedTuple):
    """The shift at which two series agree best.

    Attributes:
        offset_ms: above 0: the follower is late.
        correlation: Pearson's, at the nearest whole frame.
    """

    offset_ms: float
    correlation: float


def lip_opening(
    motion: Array, upper: Array, lower: Array, *, up: Array = (0.0, 1.0, 0.0)
) -> torch.Tensor:
    """Gap of the lips: mean over pairs of (m[upper] - m[lower]) . up.

    Args:
        motion: (B, T, V, 3) float, or (T, V, 3), m; of displacements it is the change against neutral.
        upper: (P,) vertices of the upper lip.
        lower: (P,) those that face them.
        up: (3,) unit vector to the top of the head.

    Returns:
        (B, T) float64, or (T,), m.

    Raises:
        ValueError: shapes do not fit, or ``up`` is no unit vector.
    """
    tensors, single = batched(floats(motion), dims=4)
    result: torch.Tensor = _native.metrics.lip_opening(
        tensors[0],
        torch.as_tensor(upper).to(torch.int64),
        lower=torch.as_tensor(lower).to(torch.int64),
        up=floats(up).to(torch.float64),
    )
    return result[0] if single else result


def correlation(a: Array, b: Array, *, valid: Array | None = None) -> torch.Tensor:
    """Pearson's correlation of two series, such as two lip openings; 0 where one is constant.

    Args:
        a: (B, T) float, or (T,).
        b: likewise.
        valid: frames that count, bool of that shape; ``None``: all.

    Returns:
        (B,) float64, or ().

    Raises:
        ValueError: shapes do not fit.
    """
    tensors, single = batched(floats(a), floats(b), flags(valid), dims=2)
    result: torch.Tensor = _native.metrics.correlation(tensors[0], tensors[1], valid=tensors[2])
    return result[0] if single else result


def lip_closures(
    opening: Array,
    phones: Iterable[tuple[float, float, str]],
    fps: float,
    *,
    closed: float = 0.0,
    share: float = 0.15,
    largest: float = 0.0,
) -> list[bool]:
    """For each p, b, m that begins within the series: do the lips close during it?

    Closed is an opening of at most ``closed + share * (largest - closed)``. The closure rate is the
    mean of the answers.

    Args:
        opening: (T,) float, m.
        phones: (start in s, end in s, ARPABET label without stress).
        fps: frames per second.
        closed: opening of closed lips; 0 is the neutral face.
        share: of the largest opening that still counts as closed, in [0, 1).
        largest: the largest opening; 0: that of the series itself. Give the ground truth's to judge a
            prediction by it.

    Raises:
        ValueError: a value is out of its range.
    """
    sounds = [(float(start), float(end), str(label)) for start, end, label in phones]
    return _native.metrics.lip_closures(
        floats(opening), sounds, fps=fps, closed=closed, share=share, largest=largest
    )


def log_energy(wave: Array, num_frames: int, fps: float, sample_rate_hz: float) -> torch.Tensor:
    """Log of the audio's energy around each frame (Hann window of two frames).

    Args:
        wave: (S,) float samples.
        num_frames: T.
        fps: frames per second.
        sample_rate_hz: of the samples.

    Returns:
        (T,) float64; silence is a millionth of the loudest frame.

    Raises:
        ValueError: no samples, or a rate that is not positive.
    """
    return _native.metrics.log_energy(
        floats(wave), num_frames, fps=fps, sample_rate_hz=sample_rate_hz
    )


def best_offset(
    follower: Array, leader: Array, fps: float, *, max_offset_ms: float = 300.0
) -> Offset:
    """How late one series is against another: lips against the audio's energy, or against true lips.

    Of all whole-frame lags the one whose overlap correlates most (the smallest, where equal), refined
    by the parabola through it and its neighbours.

    Args:
        follower: (T,) float, such as the lip opening.
        leader: (T,) float, such as :func:`log_energy`.
        fps: frames per second.
        max_offset_ms: largest lag that is looked at.

    Returns:
        The offset, 0 where a series is constant, and the correlation there.

    Raises:
        ValueError: lengths differ, or are fewer than four frames beyond the largest lag.
    """
    found = _native.metrics.best_offset(
        floats(follower), floats(leader), fps=fps, max_offset_ms=max_offset_ms
    )
    return Offset(*found)
