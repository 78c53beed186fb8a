"""Surfaces that a head's codes move: of fixed topology, smoothed, or extracted where they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from freetalk import _native
from freetalk.head.model import PreparedHead

SmoothingOptions = _native.head.SmoothingOptions
TrackOptions = _native.head.TrackOptions


def track(
    head: PreparedHead,
    template: torch.Tensor | np.ndarray,
    z_exp: torch.Tensor,
    *,
    refined: Sequence[int] | np.ndarray = (),
    options: _native.head.TrackOptions | None = None,
    smoothing: _native.head.SmoothingOptions | None = None,
    on_frame: Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """A template of fixed topology moved by expressions.

    Args:
        head: of one identity.
        template: (V, 3) canonical points in metres: of ``extract(head, 0)``, of a face model's mesh, or of any
            mesh by :func:`canonical_template`.
        z_exp: (T, E) codes.
        refined: vertices of lips and lids, put on their own side by Newton's method on the backward network.
        options: ``TrackOptions``.
        smoothing: ``SmoothingOptions``; None is none.
        on_frame: called with frames done and frames in all; may raise to stop.

    Returns:
        (T, V, 3) float32, metres.

    Raises:
        ValueError: a shape does not fit, or numbers are not finite.
    """
    return _native.head.track(
        head.native,
        _float32(template),
        z_exp,
        refined=[int(v) for v in refined],
        options=options or TrackOptions(),
        smoothing=smoothing or SmoothingOptions(),
        on_frame=on_frame,
    )


def canonical_template(
    head: PreparedHead, vertices: torch.Tensor | np.ndarray, z_exp: torch.Tensor | None = None
) -> torch.Tensor:
    """A posed mesh in canonical space, as a template of :func:`track`.

    Args:
        head: of the mesh's identity.
        vertices: (V, 3) metres.
        z_exp: (E,) code of its pose; None is the head's ``rest_expression``.

    Returns:
        (V, 3) float32, metres.
    """
    return _native.head.canonical_template(head.native, _float32(vertices), z_exp)


def smoothing_weights(
    head: PreparedHead, points: torch.Tensor, options: _native.head.SmoothingOptions
) -> torch.Tensor:
    """Weights w of FaceTalk's Eq. 14, (N,) in [0, 1], at points (N, 3) in head units."""
    return _native.head.smoothing_weights(head.native, points, options)


def _float32(values: torch.Tensor | np.ndarray) -> torch.Tensor:
    """A copy where an array may not be written to, as those of surfaces."""
    if isinstance(values, torch.Tensor):
        return values.to(torch.float32)
    return torch.tensor(values, dtype=torch.float32)


SurfaceOptions = _native.head.SurfaceOptions


@dataclass(frozen=True)
class Surface:
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) float64, metres.
        faces: (F, 3) int32, turned outward.
        num_evaluations: points at which the field was asked.
    """

    vertices: np.ndarray
    faces: np.ndarray
    num_evaluations: int


class SurfaceExtractor:
    """Marching cubes on a fine grid whose corners are asked only where the surface is.

    Args:
        head: of one identity.
        options: ``SurfaceOptions``; None is its defaults: 256 cells along each axis, closed at the head's box.
        smoothing: ``SmoothingOptions``; None is none.

    Raises:
        ValueError: options that do not fit each other.
    """

    def __init__(
        self,
        head: PreparedHead,
        options: _native.head.SurfaceOptions | None = None,
        smoothing: _native.head.SmoothingOptions | None = None,
    ) -> None:
        self._native = _native.head.SurfaceExtractor(
            head.native, options or SurfaceOptions(), smoothing or SmoothingOptions()
        )

    def extract(self, z_exp: torch.Tensor) -> Surface:
        """The surface under an expression (E,), by itself.

        Raises:
            RuntimeError: there is no surface within the head's box, or it leaves the box and may not.
        """
        return _surface(self._native.extract(z_exp))

    def next(self, z_exp: torch.Tensor) -> Surface:
        """The surface of a sequence's next frame, begun from the cells of the last one."""
        return _surface(self._native.next(z_exp))


def extract(
    head: PreparedHead,
    z_exp: torch.Tensor,
    *,
    options: _native.head.SurfaceOptions | None = None,
    smoothing: _native.head.SmoothingOptions | None = None,
) -> Surface:
    """The surface of a head under one expression; see :class:`SurfaceExtractor`."""
    return SurfaceExtractor(head, options, smoothing).extract(z_exp)


def _surface(native: _native.head.Surface) -> Surface:
    return Surface(native.vertices, native.faces, native.num_evaluations)
