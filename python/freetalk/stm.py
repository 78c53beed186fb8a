"""STM, Sparse-To-Mesh: landmark displacements to vertex displacements on a mesh of any topology."""

from __future__ import annotations

from typing import Any

import torch

from freetalk import _native
from freetalk._module import NativeModule

StmOptions = _native.stm.StmOptions
DecodeOptions = _native.stm.DecodeOptions
FrameDecoder = _native.stm.FrameDecoder
AdaptiveOptions = _native.stm.AdaptiveOptions
AdaptiveReport = _native.stm.AdaptiveReport
FollowOptions = _native.stm.FollowOptions
LandmarkCarrier = _native.stm.LandmarkCarrier
LandmarkFollower = _native.stm.LandmarkFollower
MeshFeatures = _native.stm.MeshFeatures
landmark_adjacency = _native.stm.landmark_adjacency
landmark_edges = _native.stm.landmark_edges
landmark_mirror = _native.stm.landmark_mirror


class Stm(NativeModule):
    """Mesh encoder, landmark encoder with cross-attention, surface decoder [FreeTalk 3.2, Eq. 12-14].

    The options ``extractor``, ``decoder`` and ``fusion`` name the component substitutions of the
    supplement's Tables 1 and 2; by default both networks are DiffusionNets.

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
            operators: of ``positions / options.length_scale``, with ``options.k_eig`` eigenpairs
                where a DiffusionNet is in use.
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

    def attention(self, mesh: _native.stm.MeshFeatures, landmarks: torch.Tensor) -> torch.Tensor:
        """How much each vertex looks at each landmark [FreeTalk, Eq. 13-14; supp. Fig. 2].

        Args:
            mesh: ``encode``'s result.
            landmarks: (T, 68, 3) displacements in metres.

        Returns:
            (T, heads, V, 68) weights; each row over the landmarks sums to one.

        Raises:
            ValueError: the fusion ``concat`` does not attend, or the shapes do not fit.
        """
        return self._impl.attention(mesh, landmarks)

    def frame_decoder(
        self,
        mesh: _native.stm.MeshFeatures,
        operators: _native.geometry.SurfaceOperators,
        *,
        precision: str = "float32",
        memory_bytes: int = 256 << 20,
        follower: LandmarkFollower | None = None,
    ) -> FrameDecoder:
        """A fast ``decode`` without gradients for many frames of one mesh.

        Args:
            mesh: ``encode``'s result.
            operators: those given to ``encode``.
            precision: ``"float32"``, or ``"bfloat16"`` for products in bfloat16 with float32 sums where
                the processor multiplies it.
            memory_bytes: working memory; does not grow with the number of frames.
            follower: of the same mesh: displacements follow the landmarks; None: as ``decode`` gives them.

        Returns:
            An object whose ``decode(landmarks)`` takes (T, 68, 3) metres and returns (T, V, 3) metres.
            It keeps the weights of now.

        Raises:
            ValueError: an unknown precision.
        """
        options = DecodeOptions(precision=precision, memory_bytes=memory_bytes)
        followed: Any = follower
        return FrameDecoder(
            self._plain_impl, mesh, operators=operators, options=options, follower=followed
        )

    def frames_per_chunk(self, num_vertices: int, memory_bytes: int) -> int:
        """Frames that ``decode`` takes at once within ``memory_bytes``."""
        return self._impl.frames_per_chunk(num_vertices, memory_bytes)


def decode_adaptively(
    decoder: FrameDecoder,
    landmarks: torch.Tensor,
    *,
    tolerance_mm: float = 0.2,
    tolerance_mean: float = 0.005,
) -> tuple[torch.Tensor, AdaptiveReport]:
    """A clip from a few decoded frames, the others interpolated between them over the landmarks.

    Args:
        decoder: of ``Stm.frame_decoder``.
        landmarks: (T, 68, 3) displacements in metres.
        tolerance_mm: largest error of a vertex; 0 decodes every frame.
        tolerance_mean: mean error as a share of the clip's mean motion.

    Returns:
        (T, V, 3) displacements in metres, and what was decoded with the errors to expect in between.

    Raises:
        ValueError: another shape, or a tolerance out of range.
    """
    options = AdaptiveOptions(tolerance_mm=tolerance_mm, tolerance_mean=tolerance_mean)
    return _native.stm.decode_adaptively(decoder, landmarks, options=options)


__all__ = [
    "AdaptiveOptions",
    "AdaptiveReport",
    "DecodeOptions",
    "FollowOptions",
    "FrameDecoder",
    "LandmarkFollower",
    "MeshFeatures",
    "Stm",
    "StmOptions",
    "decode_adaptively",
    "landmark_adjacency",
    "landmark_edges",
    "landmark_mirror",
]
