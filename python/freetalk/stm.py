"""STM, Sparse-To-Mesh: landmark displacements to vertex displacements on a mesh of any topology."""

from __future__ import annotations

import torch

from freetalk import _native
from freetalk._module import NativeModule

StmOptions = _native.stm.StmOptions
MeshFeatures = _native.stm.MeshFeatures


class Stm(NativeModule):
    """DiffusionNet encoder, landmark encoder with cross-attention, DiffusionNet decoder [FreeTalk 3.2, Eq. 12-14].

    Args:
        options: an ``StmOptions``, or its fields by keyword.
    """

    _impl_type = _native.stm.StmImpl
    _options_type = StmOptions
    _format = "freetalk-stm"

    def forward(
        self,
        positions: torch.Tensor,
        operators: _native.geometry.SurfaceOperators,
        landmarks: torch.Tensor,
    ) -> torch.Tensor:
        """Vertex displacements of all frames, differentiable.

        Args:
            positions: (V, 3) metres, canonical frame.
            operators: of ``positions / options.length_scale``, with ``options.k_eig`` eigenpairs.
            landmarks: (T, 68, 3) displacements in metres.

        Returns:
            (T, V, 3) displacements in metres.
        """
        return self._impl.forward(positions, operators, landmarks)

    def encode(
        self, positions: torch.Tensor, operators: _native.geometry.SurfaceOperators
    ) -> _native.stm.MeshFeatures:
        """What depends on the mesh alone; see ``forward`` for the arguments."""
        return self._impl.encode(positions, operators)

    def decode(
        self,
        mesh: _native.stm.MeshFeatures,
        operators: _native.geometry.SurfaceOperators,
        landmarks: torch.Tensor,
    ) -> torch.Tensor:
        """Vertex displacements (T, V, 3) in metres from ``encode``'s result."""
        return self._impl.decode(mesh, operators, landmarks)

    def frames_per_chunk(self, num_vertices: int, memory_bytes: int) -> int:
        """Frames that ``decode`` takes at once within ``memory_bytes``."""
        return self._impl.frames_per_chunk(num_vertices, memory_bytes)


__all__ = ["MeshFeatures", "Stm", "StmOptions"]
