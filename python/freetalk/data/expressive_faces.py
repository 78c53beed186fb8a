"""Linear face models with expressions, as what is fitted to scans: the built-in one's kind, and FLAME with its jaw."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.flame import Flame
from freetalk.data.landmark_transfer import LinearFace
from freetalk.data.pack import Meshing
from freetalk.mesh import boundary_loops

Points = npt.NDArray[np.float64]

_JAW_STEP = 1e-3  # radians, of the differences that tell what the jaw moves


@dataclass(frozen=True)
class ExpressiveFace(LinearFace):
    """A face model with expressions: vertices = neutral + identity . identity_basis + weights . expression_basis.

    Attributes:
        expression_basis: (E, N, 3) m.
        names: of the E expressions.
        bounds: of the weights.
        spread: deviation of a weight that is usual.
    """

    expression_basis: npt.NDArray[Any]
    names: tuple[str, ...]
    bounds: tuple[float, float] = (0.0, 1.0)
    spread: float = 0.3

    def neutral_of(self, identity: npt.NDArray[Any]) -> Points:
        """(N, 3) m: the face of an identity (K,) at rest."""
        return np.asarray(self.neutral + np.tensordot(identity, self.identity_basis, 1), np.float64)

    def posed(self, identity: npt.NDArray[Any], weights: npt.NDArray[Any]) -> Points:
        """(T, N, 3) m: an identity (K,) under weights (T, E)."""
        moved = np.tensordot(weights, self.expression_basis, 1)
        return np.asarray(self.neutral_of(identity) + moved, np.float64)

    def moves(self, identity: npt.NDArray[Any], weights: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(E, N, 3) m: what each weight changes at weights (E,)."""
        return self.expression_basis

    @property
    def moves_change(self) -> bool:
        """Whether :meth:`moves` depends on the weights."""
        return False

    @cached_property
    def inner_faces(self) -> npt.NDArray[np.bool_]:
        """(G,) triangles that touch no border: a point whose nearest place is a border lies beyond it."""
        border = np.zeros(len(self.neutral), bool)
        for loop in boundary_loops(np.asarray(self.faces).tolist()):
            border[loop] = True
        return ~border[self.faces].any(axis=1)


@dataclass(frozen=True)
class FlameFace(ExpressiveFace):
    """FLAME: expressions and, as the last three weights, the jaw's turn (axis times angle, radians).

    Attributes:
        flame: its arrays.
    """

    flame: Flame | None = None

    @staticmethod
    def of(
        flame: Flame,
        landmarks: npt.NDArray[np.integer[Any]],
        num_shapes: int = 100,
        num_expressions: int = 50,
    ) -> FlameFace:
        """FLAME with the first of its shapes and expressions.

        Args:
            flame: its arrays.
            landmarks: (68,) vertices.
            num_shapes: of the identity.
            num_expressions: beside the jaw.

        Raises:
            DatasetError: the model has fewer expressions.
        """
        basis = flame.arrays(num_expressions)["expression_basis"][:num_expressions]
        names = (*(f"expression_{i}" for i in range(num_expressions)), "jaw_x", "jaw_y", "jaw_z")
        return FlameFace(
            neutral=flame.template,
            faces=flame.faces,
            identity_basis=flame.shape_basis[:num_shapes],
            landmarks=landmarks,
            expression_basis=basis,
            names=names,
            bounds=(-np.inf, np.inf),
            spread=1.0,
            flame=flame,
        )

    @property
    def moves_change(self) -> bool:
        return True

    @cached_property
    def _meshing(self) -> Meshing:
        assert self.flame is not None
        everywhere = np.ones(len(self.neutral), bool)
        return Meshing(
            {
                "neutral": self.neutral,
                "faces": np.asarray(self.faces),
                "identity_basis": np.asarray(self.identity_basis),
                "lip_mask": everywhere,
                "upper_face_mask": everywhere,
                **self.flame.arrays(len(self.expression_basis)),
            }
        )

    def posed(self, identity: npt.NDArray[Any], weights: npt.NDArray[Any]) -> Points:
        assert self.flame is not None
        neutral = self.neutral_of(identity)
        moved = self._meshing.displacements(self.flame.factors(weights), neutral.astype(np.float32))
        return np.asarray(neutral + moved, np.float64)

    def moves(self, identity: npt.NDArray[Any], weights: npt.NDArray[Any]) -> npt.NDArray[Any]:
        turns = _JAW_STEP * np.concatenate([np.eye(3), -np.eye(3)])
        tried = np.repeat(np.asarray(weights, np.float64)[None], 6, axis=0)
        tried[:, -3:] += turns
        ahead, behind = np.split(self.posed(identity, tried), 2)
        jaw = (ahead - behind) / (2 * _JAW_STEP)
        return np.concatenate([self.expression_basis, jaw.astype(np.float32)])
