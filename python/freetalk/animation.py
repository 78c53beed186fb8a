"""A talking mesh, and the files it is written to."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from freetalk import _native
from freetalk.audio import Audio
from freetalk.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

MeshFrame = _native.animation.MeshFrame
SaveOptions = _native.animation.SaveOptions
SaveReport = _native.animation.SaveReport
PartMotion = _native.animation.PartMotion
Parts = _native.animation.Parts

__all__ = [
    "Animation",
    "MeshFrame",
    "PartMotion",
    "Parts",
    "SaveOptions",
    "SaveReport",
    "morph_basis",
    "resample_motion",
]


class Animation:
    """A mesh, one displacement per vertex and frame, and the speech it was made from.

    Args:
        mesh: the rest surface.
        displacements: (T, V, 3), in the mesh's own unit and axes; frame t is shown at t / fps.
        fps: frames per second.
        audio: the speech, if any.
        metadata: JSON values that travel with the animation.
        metres_per_unit: the mesh's unit.
        to_y_up: (3, 3) rotation of the mesh's axes to +Y up, +Z out of the face.
        head: (T, 4, 4) rigid motion of the head, in the mesh's own unit and axes, if it moves.

    Raises:
        ValueError: shapes do not fit, fps is not positive.
    """

    def __init__(
        self,
        mesh: Mesh,
        displacements: ArrayLike | torch.Tensor,
        *,
        fps: float = 30.0,
        audio: Audio | None = None,
        metadata: dict[str, Any] | None = None,
        metres_per_unit: float = 1.0,
        to_y_up: ArrayLike | None = None,
        head: ArrayLike | torch.Tensor | None = None,
    ) -> None:
        motion = torch.as_tensor(displacements).detach()
        self._native = _native.animation.Animation(
            mesh,
            motion,
            fps=fps,
            audio=audio,
            metadata_json=json.dumps(metadata or {}),
            metres_per_unit=metres_per_unit,
            to_y_up=np.eye(3) if to_y_up is None else np.asarray(to_y_up, dtype=np.float64),
            head=None if head is None else torch.as_tensor(head).detach(),
        )

    @classmethod
    def _wrap(cls, native: Any) -> Animation:
        animation = cls.__new__(cls)
        animation._native = native
        return animation

    @property
    def mesh(self) -> Mesh:
        """The rest surface."""
        return self._native.mesh

    @property
    def vertices(self) -> NDArray[np.float64]:
        """(V, 3) resting vertices."""
        return self._native.mesh.vertices

    @property
    def faces(self) -> NDArray[np.int32]:
        """(F, 3) triangles."""
        return self._native.mesh.faces

    @property
    def displacements(self) -> torch.Tensor:
        """(T, V, 3) float32, shared with the animation; ``np.asarray`` of it copies nothing."""
        return self._native.displacements

    @property
    def head(self) -> torch.Tensor | None:
        """(T, 4, 4) float64 rigid motion of the head: a vertex is at R (v + d) + t. None where it stays still."""
        return self._native.head

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._native.fps

    @property
    def audio(self) -> Audio:
        """The speech; without samples if there is none."""
        return self._native.audio

    @property
    def frame(self) -> MeshFrame:
        """The mesh's unit and axes: ``metres_per_unit``, ``to_y_up``."""
        return self._native.frame

    @property
    def metadata(self) -> dict[str, Any]:
        """What the maker of the animation says: options, alignment, notices."""
        metadata: dict[str, Any] = json.loads(self._native.metadata_json)
        return metadata

    @property
    def num_frames(self) -> int:
        """T."""
        return self._native.num_frames

    @property
    def duration_s(self) -> float:
        """T / fps."""
        return self._native.duration_s

    def vertices_at(self, frame_index: int) -> NDArray[np.float64]:
        """(V, 3) vertex positions of a frame, the head's motion included."""
        return self._native.vertices_at(frame_index)

    def save(self, path: str | os.PathLike[str], **options: Any) -> SaveReport:
        """Writes the animation by the extension of ``path``, atomically.

        ``.npz`` holds everything (``numpy.load`` reads it), ``.glb`` and ``.gltf`` hold morph targets with an
        animation of their weights, ``folder/*.obj`` and ``folder/*.ply`` one numbered mesh per frame, ``.mp4`` a
        rendered video with sound (``.webm`` likewise), ``.html`` a page that plays it in any browser, without a network.

        Args:
            path: where to write.
            options: fields of ``SaveOptions``; for ``.mp4`` those of ``freetalk.viz.save_video``, for ``.html``
                those of ``freetalk.page.save_page``.

        Returns:
            Format, number of files, number and error of morph targets.

        Raises:
            ValueError: unknown extension or option.
            RuntimeError: the path cannot be written.
        """
        if Path(path).suffix.lower() in (".mp4", ".webm"):
            from freetalk.viz import save_video

            save_video(self, path, **options)
            return SaveReport(Path(path).suffix.lower()[1:])
        if Path(path).suffix.lower() == ".html":
            from freetalk.page import save_page

            save_page(self, path, **options)
            return SaveReport("html")
        return self._native.save(path, SaveOptions(**options))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Animation:
        """Reads an ``.npz`` that ``save`` wrote.

        Raises:
            RuntimeError: the file is missing, truncated or of another content.
        """
        return cls._wrap(_native.animation.load_npz(path))

    def __repr__(self) -> str:
        return (
            f"Animation({self.mesh!r}, frames={self.num_frames}, fps={self.fps:g}, "
            f"audio={self.audio.duration_s:.2f} s)"
        )

    def __reduce__(self) -> Any:
        mesh = self.mesh
        surface = {
            "vertices": mesh.vertices,
            "polygons": mesh.polygons or mesh.faces.tolist(),
            "texcoords": mesh.texcoords,
            "polygon_texcoords": mesh.polygon_texcoords,
            "name": mesh.name,
        }
        fields = {
            "fps": self.fps,
            "audio": self.audio,
            "metadata": self.metadata,
            "metres_per_unit": self.frame.metres_per_unit,
            "to_y_up": self.frame.to_y_up,
            "head": self.head,
        }
        return _rebuild, (surface, self.displacements, fields)


def _rebuild(
    surface: dict[str, Any], displacements: torch.Tensor, fields: dict[str, Any]
) -> Animation:
    return Animation(Mesh(**surface), displacements, **fields)


def resample_motion(
    motion: torch.Tensor, from_fps: float, to_fps: float, num_frames: int
) -> torch.Tensor:
    """Catmull-Rom interpolation in time; frame t of either rate is at t / fps.

    Args:
        motion: (T, ...) floating point.
        from_fps: rate of ``motion``.
        to_fps: rate of the result.
        num_frames: length of the result.

    Returns:
        (num_frames, ...); held beyond the end of ``motion``.
    """
    return _native.animation.resample_motion(motion, from_fps, to_fps, num_frames)


def morph_basis(
    displacements: torch.Tensor, tolerance: float, max_targets: int = 128
) -> tuple[torch.Tensor, torch.Tensor, float]:
    """A displacement sequence as few morph targets.

    Args:
        displacements: (T, V, 3) float32.
        tolerance: vertex error at which no further target is added.
        max_targets: at most so many.

    Returns:
        targets (K, V, 3), weights (T, K) in [-1, 1], and the largest vertex error.
    """
    return _native.animation.morph_basis(displacements, tolerance, max_targets)
