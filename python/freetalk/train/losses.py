"""The motion loss shared by both stages [FreeTalk, Eq. 15-16]."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from freetalk.data import NUM_LANDMARKS
from freetalk.data.landmarks import EYES, LIPS

#: Of a metre. Losses count in square millimetres: in square metres gradients lie below Adam's epsilon, which
#: then, and not the learning rate, would set the steps.
MILLIMETRES = 1000.0

_CLOSED_SHARE = 0.15  # of the usual opening
_CLOSED_ENOUGH = 0.6  # of the opening that counts as closed
_CLOSURE_FRAMES = 4  # around a closure in which the lips are open
#: Usual opening of motion that hardly speaks, m.
LEAST_OPENING = 1e-4


def motion_loss(
    prediction: Tensor,
    target: Tensor,
    valid: Tensor | None = None,
    lambda_velocity: float = 0.0,
    lambda_acceleration: float = 0.0,
    point_weights: Tensor | None = None,
    counts: Tensor | None = None,
) -> dict[str, Tensor]:
    """Position, velocity and acceleration errors of a motion [FreeTalk, Eq. 15-16].

    Norms are per point and squared, averaged over valid frames and points: three times what
    ``mse_loss`` gives. Differences count where every frame they use is valid.

    Args:
        prediction: (..., T, K, 3) motion.
        target: (..., T, K, 3) motion.
        valid: (..., T) bool; ``None`` means every frame.
        lambda_velocity: weight of the first differences.
        lambda_acceleration: weight of the second differences.
        point_weights: (K,) weight of each point, mean 1; ``None`` weighs all alike (the paper).
        counts: (3 or more,) what the three sums over frames are divided by, in place of the frames of
            ``motion_counts(valid)``: their mean over the shards of a step makes the mean of the
            shards' losses the loss of all frames.

    Returns:
        ``position``, ``velocity``, ``acceleration`` and their weighted sum ``loss``; scalars.
    """
    error = prediction - target
    if valid is None:
        valid = torch.ones(error.shape[:-2], dtype=torch.bool, device=error.device)
    velocity = error[..., 1:, :, :] - error[..., :-1, :, :]
    acceleration = velocity[..., 1:, :, :] - velocity[..., :-1, :, :]
    if counts is None:
        counts = motion_counts(valid)
    frames, pairs, triples = counts[:3].clamp_min(1).unbind()
    both, three = _consecutive(valid)
    terms = {
        "position": _squared_norms(error, valid, point_weights) / frames,
        "velocity": _squared_norms(velocity, both, point_weights) / pairs,
        "acceleration": _squared_norms(acceleration, three, point_weights) / triples,
    }
    terms["loss"] = (
        terms["position"]
        + lambda_velocity * terms["velocity"]
        + lambda_acceleration * terms["acceleration"]
    )
    return terms


def motion_counts(valid: Tensor) -> Tensor:
    """Valid frames, pairs and triples of consecutive ones of (..., T) bool; (3,) float32."""
    both, three = _consecutive(valid)
    return torch.stack([valid.sum(), both.sum(), three.sum()]).float()


def _consecutive(valid: Tensor) -> tuple[Tensor, Tensor]:
    both = valid[..., 1:] & valid[..., :-1]
    return both, both[..., 1:] & both[..., :-1]


def _squared_norms(error: Tensor, valid: Tensor, point_weights: Tensor | None) -> Tensor:
    squared = error.square().sum(dim=-1)  # (..., T, K)
    if point_weights is not None:
        squared = squared * point_weights
    return (squared.mean(dim=-1) * valid).sum()


def closure_error(
    opening: Tensor,
    wanted: Tensor,
    valid: Tensor,
    usual: float,
    count: Tensor | None = None,
) -> Tensor:
    """How far lips are open that should be closed for a moment, as in p, b and m.

    The mean square of what the opening exceeds 9 % of the usual by, in the frames of :func:`closures`. A denoiser that
    is unsure when lips close otherwise answers with half-open ones. Lips that are closed enough feel no pull: pressing
    them further would also lower the openings around, where the denoiser is no surer.

    Args:
        opening: (..., T) m.
        wanted: (..., T) m.
        valid: (..., T) bool.
        usual: root mean square of the openings of all data, m.
        count: scalar that the sum over frames is divided by, in place of the frames of
            :func:`closures`: as for :func:`motion_loss`.

    Returns:
        Scalar, relative to the square of the usual opening.
    """
    usual = max(usual, LEAST_OPENING)
    counted = closures(wanted, valid, usual)
    excess = (opening - _CLOSED_ENOUGH * _CLOSED_SHARE * usual).clamp_min(0)
    frames = counted.sum() if count is None else count
    return (excess.square() * counted).sum() / frames.clamp_min(1) / usual**2


def closures(wanted: Tensor, valid: Tensor, usual: float) -> Tensor:
    """Frames (..., T) bool whose lips should be closed for a moment.

    Their opening is at most 15 % of the usual and rises above twice that within four frames, so that long pauses do
    not count. Arguments as for :func:`closure_error`.
    """
    closed = _CLOSED_SHARE * max(usual, LEAST_OPENING)
    reach = 2 * _CLOSURE_FRAMES + 1
    rows = (wanted * valid).reshape(-1, 1, wanted.shape[-1])
    nearby = torch.nn.functional.max_pool1d(rows, reach, stride=1, padding=_CLOSURE_FRAMES)
    return valid & (wanted <= closed) & (nearby.view_as(wanted) > 2 * closed)


def landmark_weights(lips: float, eyes: float, device: torch.device) -> Tensor | None:
    """(68,) weights of mean 1 of the landmarks, by those of lips and eyelids; ``None`` where all weigh alike."""
    if lips == eyes == 1.0:
        return None
    weights = torch.ones(NUM_LANDMARKS)
    weights[list(LIPS)] = lips
    weights[list(EYES)] = eyes
    return (weights / weights.mean()).to(device)


def vertex_errors(
    prediction: Tensor, target: Tensor, lips: Tensor | Sequence[int]
) -> tuple[float, float]:
    """LVE (mm^2, mean over frames of the lips' largest squared error) and MVE (mm) of motion (T, P, 3) m."""
    error = MILLIMETRES * (prediction - target).norm(dim=-1)
    lve = error[:, lips].square().amax(dim=-1).mean() if len(lips) else error.new_tensor(math.nan)
    return float(lve), float(error.mean())
