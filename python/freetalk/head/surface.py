"""The surface of a head as a triangle mesh, extracted where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from freetalk import _native
from freetalk.head.model import PreparedHead
from freetalk.head.track import SmoothingOptions

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
