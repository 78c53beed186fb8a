"""What the viewer needs to know of an animation: points, faces, motion, sound and the upright pose."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float32]
Faces = NDArray[np.int64]


@dataclass
class Sequence:
    """A moving mesh, ready to be drawn.

    Attributes:
        vertices: (V, 3) resting points, in the mesh's own unit and axes.
        faces: (F, 3) triangles.
        displacements: (T, V, 3) offsets from the resting points, same unit.
        fps: Frames per second.
        samples: (S,) mono sound in [-1, 1]; empty if there is none.
        sample_rate_hz: Rate of ``samples``.
        upright_matrix: (4, 4) similarity into metres, +Y up, +Z out of the face.
        head: (T, 4, 4) rigid motion of the head, in the mesh's own unit and axes; None where it stays still.
        located: Whether that matrix also brings the face's mean landmark to the origin.
    """

    vertices: Points
    faces: Faces
    displacements: NDArray[np.float32]
    fps: float
    samples: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, np.float32))
    sample_rate_hz: int = 16000
    upright_matrix: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    located: bool = False
    head: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        vertices, faces, motion = self.vertices, self.faces, self.displacements
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise ValueError(f"vertices must be (V, 3), found {vertices.shape}")
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise ValueError(f"faces must be (F, 3) with at least one face, found {faces.shape}")
        if motion.ndim != 3 or motion.shape[1:] != vertices.shape or len(motion) == 0:
            expected = f"(T, {len(vertices)}, 3) with at least one frame"
            raise ValueError(f"displacements must be {expected}, found {motion.shape}")
        if not self.fps > 0:
            raise ValueError(f"fps must be above 0, found {self.fps}")

    @classmethod
    def at_rest(cls, mesh: Any, pose: Any, *, located: bool = False) -> Sequence:
        """One frame of a ``freetalk.Mesh`` that does not move.

        Args:
            mesh: in its own unit and axes.
            pose: similarity into metres, +Y up, +Z out of the face.
            located: whether that also brings the face's mean landmark to the origin.
        """
        matrix = np.eye(4)
        matrix[:3, :3] = pose.scale * np.asarray(pose.rotation)
        matrix[:3, 3] = np.asarray(pose.translation).reshape(3)
        vertices = np.asarray(mesh.vertices, np.float32)
        still = np.zeros((1, *vertices.shape), np.float32)
        faces = np.asarray(mesh.faces, np.int64)
        return cls(vertices, faces, still, 30.0, upright_matrix=matrix, located=located)

    @property
    def num_frames(self) -> int:
        """Number of motion frames T."""
        return len(self.displacements)

    @property
    def duration_s(self) -> float:
        """Length of the motion in seconds."""
        return self.num_frames / self.fps

    def frame(self, index: int) -> Points:
        """Returns the (V, 3) points of one frame."""
        return self.vertices + self.displacements[index]

    def at_time(self, time_s: float) -> Points:
        """Returns the (V, 3) points at a time, interpolated linearly between frames."""
        position = float(np.clip(time_s * self.fps, 0, self.num_frames - 1))
        first = int(position)
        second = min(first + 1, self.num_frames - 1)
        blend = np.float32(position - first)
        if blend < 1e-4 or first == second:
            return self.frame(first)
        motion = (1 - blend) * self.displacements[first] + blend * self.displacements[second]
        return self.vertices + motion

    def head_at(self, time_s: float) -> NDArray[np.float64]:
        """Returns the (4, 4) pose of the head at a time, upright and in metres, linear between frames."""
        if self.head is None:
            return np.eye(4)
        position = float(np.clip(time_s * self.fps, 0, self.num_frames - 1))
        first = int(position)
        second = min(first + 1, self.num_frames - 1)
        blend = position - first
        pose = (1 - blend) * self.head[first] + blend * self.head[second]
        return self.upright_matrix @ pose @ np.linalg.inv(self.upright_matrix)

    def upright(self, points: NDArray[Any]) -> Points:
        """Brings (V, 3) points upright, to metres."""
        matrix = self.upright_matrix.astype(np.float32)
        return np.asarray(points, dtype=np.float32) @ matrix[:3, :3].T + matrix[:3, 3]


def as_sequence(animation: Any) -> Sequence:
    """Reads a ``freetalk.Animation``, a :class:`Sequence` or the path of an animation ``.npz``.

    Args:
        animation: What to draw.

    Returns:
        The same animation as a :class:`Sequence`; large arrays are shared, not copied.
    """
    if isinstance(animation, Sequence):
        return animation
    if isinstance(animation, str | os.PathLike):
        from freetalk import Animation

        animation = Animation.load(Path(animation))
    mesh = animation.mesh
    canonical = _canonical_matrix(getattr(animation, "metadata", None))
    samples, rate = _sound(getattr(animation, "audio", None))
    return Sequence(
        vertices=np.asarray(mesh.vertices, dtype=np.float32),
        faces=np.asarray(mesh.faces, dtype=np.int64),
        displacements=np.asarray(animation.displacements, dtype=np.float32),
        fps=float(animation.fps),
        samples=samples,
        sample_rate_hz=rate,
        upright_matrix=_frame_matrix(animation) if canonical is None else canonical,
        located=canonical is not None,
        head=None if getattr(animation, "head", None) is None else np.asarray(animation.head),
    )


def _sound(audio: Any) -> tuple[NDArray[np.float32], int]:
    if audio is None or len(audio.samples) == 0:
        return np.zeros(0, np.float32), 16000
    return np.asarray(audio.samples, dtype=np.float32), int(audio.sample_rate_hz)


def _canonical_matrix(metadata: Any) -> NDArray[np.float64] | None:
    """The similarity stored by the talker: scale, rotation (rows or 9 numbers), translation."""
    if not isinstance(metadata, Mapping):
        return None
    alignment = metadata.get("alignment")
    if not isinstance(alignment, Mapping):
        return None
    similarity = alignment.get("to_canonical", alignment)
    if not isinstance(similarity, Mapping) or "rotation" not in similarity:
        return None
    matrix = np.eye(4)
    rotation = np.asarray(similarity["rotation"], dtype=np.float64).reshape(3, 3)
    matrix[:3, :3] = float(similarity.get("scale", 1.0)) * rotation
    matrix[:3, 3] = np.asarray(similarity.get("translation", [0, 0, 0]), dtype=np.float64)
    return matrix if np.isfinite(matrix).all() else None


def _frame_matrix(animation: Any) -> NDArray[np.float64]:
    """What an animation says of its unit and axes when no alignment is stored."""
    matrix = np.eye(4)
    frame = getattr(animation, "frame", None)
    if frame is not None:
        turn = np.asarray(frame.to_y_up, dtype=np.float64)
        matrix[:3, :3] = float(frame.metres_per_unit) * turn
    return matrix
