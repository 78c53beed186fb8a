"""Motion in few bytes: principal components on a grid of 16-bit steps, with the error that it costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk.animation import morph_basis

#: Of the error that is allowed, how much is left to the components that are cut off; steps take the rest.
_BASIS_SHARE = 0.8
_WEIGHT_STEPS = 65535
_STEP_LIMIT = 32767
_BLOCK = 16


@dataclass(frozen=True)
class PackedMotion:
    """Displacements as ``step_m * weights / 65535 @ targets``.

    Attributes:
        targets: (K, V, 3) int16.
        weights: (T, K) uint16.
        step_m: metres of a unit of ``targets``.
        error_mm: largest distance of a vertex from its true displacement over all frames, measured.
    """

    targets: NDArray[np.int16]
    weights: NDArray[np.uint16]
    step_m: float
    error_mm: float


def pack_motion(
    displacements: NDArray[np.float32], to_metres: NDArray[np.float64], tolerance_mm: float
) -> PackedMotion:
    """Packs displacements to within a tolerance.

    Args:
        displacements: (T, V, 3) in any unit and axes.
        to_metres: (3, 3) similarity without its shift, into upright metres.
        tolerance_mm: largest error of a vertex; motion of more than 512 components may miss it.

    Returns:
        The motion in upright metres; ``error_mm`` says what was reached.
    """
    unit_m = float(np.cbrt(abs(np.linalg.det(to_metres))))
    allowed_m = 1e-3 * tolerance_mm
    targets, weights, _ = morph_basis(
        torch.as_tensor(displacements),
        _BASIS_SHARE * allowed_m / unit_m,
        min(512, len(displacements) + 1),
    )
    turned = np.asarray(targets) @ to_metres.T.astype(np.float32)
    largest = float(np.abs(turned).max(initial=0.0))
    # Rounding errors of K components add up like those of a random walk.
    fine_m = (1 - _BASIS_SHARE) * allowed_m / np.sqrt(max(len(turned), 1))
    step_m = max(fine_m, largest / _STEP_LIMIT)
    packed = np.rint(turned / step_m).astype(np.int16)
    shares = np.rint(np.asarray(weights).clip(0, 1) * _WEIGHT_STEPS).astype(np.uint16)
    error_m = _largest_error(displacements, to_metres, packed, shares, step_m)
    return PackedMotion(packed, shares, step_m, 1e3 * error_m)


def unpack_motion(packed: PackedMotion) -> NDArray[np.float32]:
    """(T, V, 3) float32 displacements, upright metres, as the page shows them."""
    return _unpack(packed.targets, packed.weights, packed.step_m)


def _unpack(
    targets: NDArray[np.int16], weights: NDArray[np.uint16], step_m: float
) -> NDArray[np.float32]:
    scaled = weights.astype(np.float32) * np.float32(step_m / _WEIGHT_STEPS)
    flat = scaled @ targets.reshape(len(targets), 3 * targets.shape[1]).astype(np.float32)
    return flat.reshape(len(weights), *targets.shape[1:])


def _largest_error(
    displacements: NDArray[np.float32],
    to_metres: NDArray[np.float64],
    targets: NDArray[np.int16],
    weights: NDArray[np.uint16],
    step_m: float,
) -> float:
    largest = 0.0
    turn = to_metres.T.astype(np.float32)
    for first in range(0, len(weights), _BLOCK):
        block = slice(first, first + _BLOCK)
        off = _unpack(targets, weights[block], step_m) - displacements[block] @ turn
        largest = max(largest, float(np.einsum("tvc,tvc->tv", off, off).max()))
    return float(np.sqrt(largest))
