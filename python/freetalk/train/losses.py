"""The motion loss shared by both stages [FreeTalk, Eq. 15-16]."""

from __future__ import annotations

import torch
from torch import Tensor


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
        counts: (3,) what the three sums over frames are divided by, in place of the frames of
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
    frames, pairs, triples = counts.clamp_min(1).unbind()
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
