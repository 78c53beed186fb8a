"""Codes of a parametric head from points of a surface: scans, registered meshes, depth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from freetalk import _native
from freetalk.head.model import ParametricHead

FitOptions = _native.head.FitOptions


@dataclass(frozen=True)
class Fit:
    """Codes and how near their surface comes to the points.

    Attributes:
        z_id: (D,).
        z_exp: (T, E).
        error_mm: (T,) mean distance of each frame's points by the head's own field.
    """

    z_id: torch.Tensor
    z_exp: torch.Tensor
    error_mm: torch.Tensor


def fit_expressions(
    head: ParametricHead,
    z_id: torch.Tensor,
    points: Sequence[torch.Tensor | np.ndarray],
    *,
    prior: torch.Tensor | None = None,
    options: _native.head.FitOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> Fit:
    """Expression codes of the frames of a known identity.

    Args:
        head: on the CPU, in eval mode.
        z_id: (D,) the identity's code.
        points: T of (P_t, 3) points of the posed surface, metres, in the head's frame.
        prior: (T, E) codes to begin from and to stay near; None is the head's ``rest_expression``.
        options: ``FitOptions``: Gauss-Newton over all frames together, or FaceTalk's Adam by ``method="adam"``.
        seed: of the points that are drawn.
        on_step: called with steps done and steps in all; may raise to stop.

    Raises:
        ValueError: a frame without points, numbers that are not finite, or a shape that does not fit.
    """
    found = _native.head.fit_expressions(
        head._plain_impl,
        z_id,
        [torch.as_tensor(own, dtype=torch.float32) for own in points],
        prior=prior,
        options=options or FitOptions(),
        seed=seed,
        on_step=on_step,
    )
    return Fit(found.z_id, found.z_exp, found.error_mm)


def fit_identity(
    head: ParametricHead,
    points: Sequence[torch.Tensor | np.ndarray],
    *,
    prior: torch.Tensor | None = None,
    identity_prior: torch.Tensor | None = None,
    options: _native.head.FitOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> Fit:
    """The identity that frames share, and their expressions, by Gauss-Newton.

    Args:
        head: on the CPU, in eval mode. Where it has ``identity_map``, the map's coefficients are sought.
        points: T of (P_t, 3) points of the posed surfaces, metres, in the head's frame.
        prior: (T, E) expressions to begin from and to stay near; None is the head's ``rest_expression``.
        identity_prior: (D,) begun from; None is the head's mean.
        options: ``FitOptions``.
        seed: of the points that are drawn.
        on_step: called with steps done and steps in all; may raise to stop.

    Raises:
        ValueError: as :func:`fit_expressions`.
    """
    found = _native.head.fit_identity(
        head._plain_impl,
        [torch.as_tensor(own, dtype=torch.float32) for own in points],
        prior=prior,
        identity_prior=identity_prior,
        options=options or FitOptions(),
        seed=seed,
        on_step=on_step,
    )
    return Fit(found.z_id, found.z_exp, found.error_mm)
