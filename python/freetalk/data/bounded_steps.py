"""Steps of Gauss-Newton for the poses and bounded weights of all frames of a sequence together.

A frame's unknowns are six of its pose and E weights. With ``H`` the blocks of the frames' normal equations and ``D`` the
second differences in time, a step solves

    (H + q D'D) dx = g

by conjugate gradients, the blocks of each frame as preconditioner. Weights that it would take over a bound stop there.
"""

from __future__ import annotations

import torch
from torch import Tensor

#: Unknowns of a frame's pose, which come first.
POSE = 6
_CG_STEPS = 6
_BOUND_ROUNDS = 2
_HELD = 1e6


def second_differences(state: Tensor, inner: Tensor) -> Tensor:
    """D'D applied to (T, X); `inner` (T - 2,) marks the differences that lie within a clip."""
    if len(state) < 3:
        return torch.zeros_like(state)
    bend = (state[2:] - 2 * state[1:-1] + state[:-2]) * inner[:, None]
    result = torch.zeros_like(state)
    result[2:] += bend
    result[1:-1] -= 2 * bend
    result[:-2] += bend
    return result


def held_weights(gradient: Tensor, weights: Tensor, bounds: tuple[float, float]) -> Tensor:
    """(T, E) bool: weights at a bound that the gradient (T, 6 + E) pulls beyond it."""
    pull, (low, high) = gradient[:, POSE:], bounds
    return ((weights <= low) & (pull < 0)) | ((weights >= high) & (pull > 0))


def with_held(normal: Tensor, held: Tensor) -> Tensor:
    """Blocks (T, 6 + E, 6 + E) whose solutions leave the held weights (T, E) where they are."""
    blocks = normal.clone()
    blocks.diagonal(dim1=1, dim2=2)[:, POSE:] += _HELD * held
    return blocks


def bounded_step(
    normal: Tensor,
    gradient: Tensor,
    weights: Tensor,
    smooth: Tensor,
    inner: Tensor,
    bounds: tuple[float, float] = (0.0, 1.0),
) -> Tensor:
    """The step (T, 6 + E); weights that it would take over a bound go to the bound, and the others make up for it.

    Args:
        normal: (T, 6 + E, 6 + E) blocks of the normal equations.
        gradient: (T, 6 + E) their right sides.
        weights: (T, E) as they are.
        smooth: (6 + E,) weights q of the squared second differences.
        inner: (T - 2,) bool, differences over three frames of one clip.
        bounds: of all weights.
    """
    held = held_weights(gradient, weights, bounds)
    way = torch.zeros_like(weights)  # of the held ones, to their bound
    for _ in range(_BOUND_ROUNDS):
        wanted = gradient.clone()
        wanted[:, POSE:] += _HELD * held * way
        change = _conjugate_gradients(with_held(normal, held), wanted, smooth, inner)
        reached = weights + change[:, POSE:]
        crossing = ((reached < bounds[0]) | (reached > bounds[1])) & ~held
        way = torch.where(crossing, reached.clamp(*bounds) - weights, way)
        held = held | crossing
    return change


def _conjugate_gradients(normal: Tensor, gradient: Tensor, smooth: Tensor, inner: Tensor) -> Tensor:
    blocks = normal + torch.diag(6 * smooth)
    factor = torch.linalg.cholesky(blocks)
    change = torch.zeros_like(gradient)
    left = gradient.clone()
    step = torch.cholesky_solve(left[..., None], factor)[..., 0]
    direction, power = step, (left * step).sum()
    for _ in range(_CG_STEPS):
        image = torch.einsum("txy,ty->tx", normal, direction)
        image += smooth * second_differences(direction, inner)
        length = power / (direction * image).sum().clamp_min(1e-30)
        change = change + length * direction
        left = left - length * image
        step = torch.cholesky_solve(left[..., None], factor)[..., 0]
        previous, power = power, (left * step).sum()
        direction = step + power / previous.clamp_min(1e-30) * direction
    return change


def turned(rotation: Tensor, angles: Tensor) -> Tensor:
    """Rotations (T, 3, 3) turned further by small ones about the axes of the target, (T, 3) radians."""
    x, y, z = angles.unbind(1)
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).unflatten(1, (3, 3))
    return torch.linalg.matrix_exp(skew) @ rotation


def turn_angles(turn: Tensor) -> Tensor:
    """Rotations (T, 3, 3) near the identity as numbers (T, 3) that differ as they do."""
    return 0.5 * torch.stack(
        [
            turn[:, 2, 1] - turn[:, 1, 2],
            turn[:, 0, 2] - turn[:, 2, 0],
            turn[:, 1, 0] - turn[:, 0, 1],
        ],
        1,
    )
