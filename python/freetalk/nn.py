"""Layers that know no task: DiffusionNet, sparse products, the landmark graph."""

from __future__ import annotations

import torch

from freetalk import _native
from freetalk._module import NativeModule

DiffusionNetOptions = _native.nn.DiffusionNetOptions
band_mask = _native.nn.band_mask
landmark_adjacency = _native.nn.landmark_adjacency
landmark_edges = _native.nn.landmark_edges
landmark_mirror = _native.nn.landmark_mirror
sinusoidal_code = _native.nn.sinusoidal_code
sparse_product = _native.nn.sparse_product


class DiffusionNet(NativeModule):
    """DiffusionNet [Sharp et al. 2022] over many frames of one mesh; names equal the public package's.

    Args:
        options: a ``DiffusionNetOptions``, or its fields by keyword.
    """

    _impl_type = _native.nn.DiffusionNetImpl
    _options_type = DiffusionNetOptions
    _format = "freetalk-diffusion-net"

    def forward(
        self, x: torch.Tensor, operators: _native.geometry.SurfaceOperators
    ) -> torch.Tensor:
        """Values at the vertices, diffused and transformed.

        Args:
            x: (B, V, in_channels) float.
            operators: of one mesh with V vertices, in x's dtype.

        Returns:
            (B, V, out_channels).
        """
        return self._impl.forward(x, operators)


__all__ = [
    "DiffusionNet",
    "DiffusionNetOptions",
    "band_mask",
    "landmark_adjacency",
    "landmark_edges",
    "landmark_mirror",
    "sinusoidal_code",
    "sparse_product",
]
