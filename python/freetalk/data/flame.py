"""FLAME (Li et al. 2017): the factors of a meshing, for datasets that store its parameters."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from freetalk.data.errors import DatasetError, MissingFileError
from freetalk.data.pack import FloatArray
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

    def factors(self, values: npt.NDArray[Any]) -> FloatArray:
        """(T, E + 9) factors of a meshing: expression, and the jaw's rotation matrix minus the identity.

        Args:
            values: (T, E + 3) expression, and the jaw's axis times angle, radians.
        """
        turn = Rotation.from_rotvec(values[:, -3:]).as_matrix() - np.eye(3)
        return np.concatenate([values[:, :-3], turn.reshape(-1, 9)], axis=1).astype(np.float32)

    def arrays(self, num_expressions: int) -> dict[str, npt.NDArray[Any]]:
        """What a meshing needs to make vertices of :meth:`factors`.

        Raises:
            DatasetError: the model has fewer expressions.
        """
        if num_expressions > len(self.expression_basis):
            raise DatasetError(
                f"{self.source} has {len(self.expression_basis)} expressions, the takes {num_expressions}"
            )
        return {
            "expression_basis": np.concatenate(
                [self.expression_basis[:num_expressions], self.jaw_basis]
            ),
            "jaw_weights": self.jaw_weights,
            "jaw_regressor": self.jaw_regressor,
        }


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
