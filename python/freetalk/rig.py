"""A face as a linear rig: ARKit's shapes and correctives that reproduce STM on one mesh.

``weights = rig.solve(landmarks)`` lie in [0, 1]; ``rig.vertices(weights)`` is linear in them, so whatever plays blend
shapes plays the rig's targets.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from freetalk import _native

RigOptions = _native.rig.RigOptions
RigPoses = _native.rig.RigPoses
SolveState = _native.rig.SolveState

__all__ = ["FaceRig", "RigOptions", "RigPoses", "SolveState"]


class FaceRig:
    """Named targets of one face; immutable, and safe to use from several threads.

    Use :meth:`build` or :meth:`load`.
    """

    def __init__(self, native: Any) -> None:
        self._native = native

    @classmethod
    def build(
        cls,
        decode: Callable[[torch.Tensor], torch.Tensor],
        poses: RigPoses | str | os.PathLike[str],
        *,
        progress: Callable[[float], None] | None = None,
        **options: Any,
    ) -> FaceRig:
        """Decodes shapes and poses and finds the correctives.

        Args:
            decode: (N, 68, 3) landmark displacements to (N, V, 3) vertex displacements, float32 metres, such
                as ``Stm.frame_decoder(...).decode``.
            poses: landmark motion that rigs are made of, or its file, ``rig_poses.safetensors`` of the weights.
            progress: called with the finished share in [0, 1]; may raise to stop.
            options: fields of ``RigOptions``: num_poses, max_correctives, tolerance_mm, l1, l2, symmetry, cancel,
                temporal, disabled.

        Raises:
            ValueError: poses or options do not fit.
            RuntimeError: ``decode`` gives other shapes or values that are not finite; a file is broken.
        """
        if not isinstance(poses, RigPoses):
            poses = RigPoses.load(os.fspath(poses))
        wanted = RigOptions(**options)
        return cls(_native.rig.FaceRig.build(decode, poses, options=wanted, progress=progress))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> FaceRig:
        """Reads what :meth:`save` wrote.

        Raises:
            RuntimeError: the file is missing, broken or no rig.
        """
        return cls(_native.rig.FaceRig.load(os.fspath(path)))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a .safetensors file."""
        self._native.save(os.fspath(path))

    @property
    def names(self) -> list[str]:
        """ARKit's names, then "corrective_00_plus", "corrective_00_minus" and so on."""
        return list(self._native.names)

    @property
    def targets(self) -> torch.Tensor:
        """(W, V, 3) float32, metres."""
        return self._native.targets

    @property
    def options(self) -> RigOptions:
        """What the rig was made with."""
        return self._native.options

    def solve(self, landmarks: torch.Tensor, state: SolveState | None = None) -> torch.Tensor:
        """Weights that reproduce landmark motion.

        Args:
            landmarks: (T, 68, 3) float32 displacements in metres.
            state: carries a stream on: the frames of several calls weigh the same as those of one.

        Returns:
            (T, W) float32 in [0, 1].

        Raises:
            ValueError: another shape, or a state of another rig.
        """
        return self._native.solve(landmarks, state)

    def vertices(self, weights: torch.Tensor) -> torch.Tensor:
        """Displacements (T, V, 3) in metres from weights (T, W).

        Raises:
            ValueError: another number of weights.
        """
        return self._native.vertices(weights)

    def curves(self, weights: torch.Tensor) -> dict[str, np.ndarray]:
        """(T,) float32 weights of each ARKit shape by name."""
        values = weights.numpy()
        return {name: values[:, k] for k, name in enumerate(self.names[: self._native.num_shapes])}
