"""FLAME (Li et al. 2017) in NumPy: expression and jaw to vertices, for datasets that store parameters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.dataset import FloatArray
from freetalk.data.errors import DatasetError, MissingFileError
from freetalk.data.templates import templates_home

_JAW = 2  # joints: global, neck, jaw, eyes
_NUM_SHAPE = 300


@dataclass(frozen=True)
class Flame:
    """The parts of the model that speech moves: head, neck and eyes stay.

    Attributes:
        template: (V, 3) float32, m.
        shape_basis: (S, V, 3).
        expression_basis: (E, V, 3).
        jaw_basis: (9, V, 3) corrective shapes of the jaw's rotation matrix minus the identity.
        jaw_weights: (V,) skinning weight of the jaw.
        jaw_regressor: (V,) weights that give the jaw's joint.
        faces: (F, 3) int64.
        source: file that it was read from.
    """

    template: FloatArray
    shape_basis: FloatArray
    expression_basis: FloatArray
    jaw_basis: FloatArray
    jaw_weights: FloatArray
    jaw_regressor: FloatArray
    faces: npt.NDArray[np.int64]
    source: str

    def neutral(self, shape: npt.NDArray[Any]) -> FloatArray:
        """(V, 3) m: the neutral face of shape coefficients (S,)."""
        count = min(len(shape), len(self.shape_basis))
        offset = np.tensordot(shape[:count], self.shape_basis[:count], axes=1)
        return (self.template + offset).astype(np.float32)

    def posed(
        self, neutral: FloatArray, expression: npt.NDArray[Any], jaw: npt.NDArray[Any]
    ) -> FloatArray:
        """Vertices of frames: expression, jaw's corrective shapes, jaw's rotation (Eq. 1-3 of FLAME).

        Args:
            neutral: (V, 3) m.
            expression: (T, E) coefficients.
            jaw: (T, 3) axis times angle, radians.

        Returns:
            (T, V, 3) float32, m.
        """
        count = min(expression.shape[1], len(self.expression_basis))
        flat = self.expression_basis[:count].reshape(count, -1)
        shaped = neutral + (expression[:, :count].astype(np.float32) @ flat).reshape(
            len(jaw), -1, 3
        )
        joint = np.einsum("v,tvd->td", self.jaw_regressor, shaped)[:, None]
        turn = rotation_matrices(jaw) - np.eye(3, dtype=np.float32)  # (T, 3, 3)
        posed = shaped + np.tensordot(turn.reshape(-1, 9), self.jaw_basis, axes=1)
        moved = np.einsum("tij,tvj->tvi", turn, posed - joint)
        return (posed + self.jaw_weights[:, None] * moved).astype(np.float32)


def rotation_matrices(vectors: npt.NDArray[Any]) -> FloatArray:
    """(T, 3, 3) rotations of axis times angle (T, 3) (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.maximum(angle, 1e-12)[:, None]).T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    sine, cosine = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return (np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)).astype(np.float32)


def find_flame(directory: Path) -> Flame:
    """FLAME's arrays from ``flame.npz`` in a dataset's folder or in the user's templates.

    Raises:
        MissingFileError: neither is there; says how to make it.
    """
    for folder in (directory, templates_home() / "flame"):
        if (folder / "flame.npz").is_file():
            return read_flame(folder / "flame.npz")
    raise MissingFileError(
        f"{directory} stores FLAME's parameters, so FLAME is needed to make faces of them: put "
        f"flame.npz there or into {templates_home() / 'flame'} (docs/datasets.md says how to make it "
        "of the licensed model)"
    )


def read_flame(path: Path) -> Flame:
    """Reads ``v_template``, ``shapedirs``, ``posedirs``, ``J_regressor``, ``weights``, ``f`` of an ``.npz``.

    Raises:
        DatasetError: an array is missing or of another shape.
    """
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    wanted = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "f")
    missing = [name for name in wanted if name not in arrays]
    if missing:
        raise DatasetError(f"{path} lacks {', '.join(missing)} of FLAME")
    count, joints = len(arrays["v_template"]), arrays["J_regressor"].shape[0]
    shapes = {
        "v_template": (count, 3),
        "posedirs": (count, 3, 9 * (joints - 1)),
        "J_regressor": (joints, count),
        "weights": (count, joints),
    }
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise DatasetError(f"{path}: {name} is {arrays[name].shape}, expected {shape}")
    directions = arrays["shapedirs"]
    if directions.shape[:2] != (count, 3) or directions.shape[2] <= _NUM_SHAPE or joints <= _JAW:
        raise DatasetError(
            f"{path}: shapedirs is {directions.shape}, expected ({count}, 3, 400): 300 of shape, then "
            "expression"
        )
    basis = np.ascontiguousarray(directions.transpose(2, 0, 1), dtype=np.float32)
    first = 9 * (_JAW - 1)
    jaw = arrays["posedirs"][..., first : first + 9]
    return Flame(
        template=arrays["v_template"].astype(np.float32),
        shape_basis=basis[:_NUM_SHAPE],
        expression_basis=basis[_NUM_SHAPE:],
        jaw_basis=np.ascontiguousarray(jaw.transpose(2, 0, 1), dtype=np.float32),
        jaw_weights=arrays["weights"][:, _JAW].astype(np.float32),
        jaw_regressor=arrays["J_regressor"][_JAW].astype(np.float32),
        faces=arrays["f"].astype(np.int64),
        source=str(path),
    )
