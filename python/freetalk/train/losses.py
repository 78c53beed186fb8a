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

    Returns:
        ``position``, ``velocity``, ``acceleration`` and their weighted sum ``loss``; scalars.
    """
    error = prediction - target
    if valid is None:
        valid = torch.ones(error.shape[:-2], dtype=torch.bool, device=error.device)
    velocity = error[..., 1:, :, :] - error[..., :-1, :, :]
    acceleration = velocity[..., 1:, :, :] - velocity[..., :-1, :, :]
    both = valid[..., 1:] & valid[..., :-1]
    three = both[..., 1:] & both[..., :-1]
    terms = {
        "position": _mean_squared_norm(error, valid, point_weights),
        "velocity": _mean_squared_norm(velocity, both, point_weights),
        "acceleration": _mean_squared_norm(acceleration, three, point_weights),
    }
    terms["loss"] = (
        terms["position"]
        + lambda_velocity * terms["velocity"]
        + lambda_acceleration * terms["acceleration"]
    )
    return terms


def _mean_squared_norm(error: Tensor, valid: Tensor, point_weights: Tensor | None) -> Tensor:
    squared = error.square().sum(dim=-1)  # (..., T, K)
    if point_weights is not None:
        squared = squared * point_weights
    per_frame = squared.mean(dim=-1) * valid  # (..., T)
    return per_frame.sum() / valid.sum().clamp_min(1)
