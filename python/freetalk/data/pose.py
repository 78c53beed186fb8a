"""Units and axes: what brings a dataset's meshes to metres in the canonical frame, exactly and stated."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk import _native
from freetalk.data.errors import DatasetError

FloatArray = npt.NDArray[np.float32]

#: Metres per unit.
UNITS: dict[str, float] = _native.core.UNITS
_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")
#: Between the outer corners of the eyes (landmarks 36 and 45): range over adults with a margin, mean.
_EYES_M, _EYES_MEAN_M = (0.065, 0.115), 0.088
#: Longest side of the box around a mesh, from a face mask to a head with shoulders.
_HEAD_M = (0.13, 0.60)


@dataclass(frozen=True)
class Pose:
    """From the file's coordinates to metres, +Y up, +Z out of the face: ``scale * rotation @ x``.

    Attributes:
        scale: metres per unit of the file.
        unit: m, cm, mm, in, or ``normalised`` where no unit fits a human head.
        rotation: (3, 3) a permutation of the axes with signs, so numbers stay what they are.
        reason: how unit and axes were found.
    """

    scale: float
    unit: str
    rotation: npt.NDArray[np.float32]
    reason: str

    def apply(self, points: FloatArray) -> FloatArray:
        """Points or displacements (..., 3)."""
        if np.array_equal(self.rotation, np.eye(3)):
            return points * np.float32(self.scale)
        return (points @ self.rotation.T) * np.float32(self.scale)

    def undo(self, points: FloatArray) -> FloatArray:
        """Points or displacements (..., 3) in the file's coordinates again."""
        file = np.asarray(points / np.float32(self.scale), np.float32) @ self.rotation
        return np.asarray(file, np.float32)

    @classmethod
    def of(cls, described: Mapping[str, Any]) -> Pose:
        """What :meth:`describe` told."""
        rotation = np.zeros((3, 3), np.float32)
        for row, axis in enumerate(described["x_y_z_from"]):
            column, negative = divmod(_AXES.index(axis), 2)
            rotation[row, column] = -1 if negative else 1
        return cls(
            described["metres_per_unit"], described["unit"], rotation, str(described["reason"])
        )

    def describe(self) -> dict[str, Any]:
        """Unit, scale, axes and reason, as results name them."""
        rows = [_AXES[2 * int(np.abs(r).argmax()) + int(r.sum() < 0)] for r in self.rotation]
        return {
            "unit": self.unit,
            "metres_per_unit": self.scale,
            "x_y_z_from": rows,
            "reason": self.reason,
        }


#: Of data that is in metres and our axes.
METRES = Pose(1.0, "m", np.eye(3, dtype=np.float32), "made so")


def find_pose(templates: list[FloatArray], landmarks: list[FloatArray], unit: str = "auto") -> Pose:
    """Unit and axes of a dataset from its neutral faces.

    Args:
        templates: neutral faces (V, 3) in the file's unit.
        landmarks: their landmarks (68, 3), or none where they are not known.
        unit: one of ``UNITS``, or ``auto``.

    Raises:
        DatasetError: an unknown unit.
    """
    rotation = np.eye(3, dtype=np.float32)
    if landmarks:
        rotation = _axes(np.mean([points - points.mean(axis=0) for points in landmarks], axis=0))
        spans = [float(np.linalg.norm(p[36] - p[45])) for p in landmarks]
        size, limits, mean = float(np.median(spans)), _EYES_M, _EYES_MEAN_M
        what = "outer corners of the eyes"
    else:
        size = float(np.median([np.ptp(points, axis=0).max() for points in templates]))
        limits, mean, what = _HEAD_M, 0.28, "longest side of the mesh"
    if unit != "auto":
        if unit not in UNITS:
            raise DatasetError(f"the unit {unit!r} is none of {', '.join(UNITS)}, auto")
        return Pose(UNITS[unit], unit, rotation, "given")
    for name, scale in UNITS.items():
        if limits[0] <= size * scale <= limits[1]:
            return Pose(scale, name, rotation, f"{what}: {size:.4g} {name}")
    scale = mean / size if size > 0 else 1.0
    reason = f"{what}: {size:.4g}, no human head in any unit; scaled to {mean} m"
    return Pose(scale, "normalised", rotation, reason)


def _axes(points: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """The signed permutation that brings landmarks nearest to +Y up, +Z forward, +X the subject's left."""
    eyes = points[36:48].mean(axis=0)
    up = eyes - points[5:12].mean(axis=0)
    left = points[42:48].mean(axis=0) - points[36:42].mean(axis=0)
    forward = np.cross(left, up)
    wanted = np.stack([v / max(float(np.linalg.norm(v)), 1e-12) for v in (left, up, forward)])
    best, rotation = -np.inf, np.eye(3)
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1, -1), repeat=3):
            candidate = np.zeros((3, 3))
            candidate[range(3), order] = signs
            score = float((candidate * wanted).sum())
            if np.linalg.det(candidate) > 0 and score > best + 1e-9:
                best, rotation = score, candidate
    return rotation.astype(np.float32)
