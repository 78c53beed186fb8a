"""A talking mesh, and the files it is written to."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from freetalk import _native
from freetalk.audio import Audio
from freetalk.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

BlendShapes = _native.animation.BlendShapes
MeshFrame = _native.animation.MeshFrame
SaveOptions = _native.animation.SaveOptions
SaveReport = _native.animation.SaveReport
PartMotion = _native.animation.PartMotion
Parts = _native.animation.Parts

__all__ = [
    "Animation",
    "BlendShapes",
    "MeshFrame",
    "PartMotion",
    "Parts",
    "SaveOptions",
    "SaveReport",
    "load_animation",
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
        landmarks: (T, 68, 3) displacements in metres, canonical frame, of which the motion was made.

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
        landmarks: torch.Tensor | None = None,
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
            landmarks=landmarks,
        )
        self._arkit_shapes: Callable[[Animation], BlendShapes] | None = None

    @classmethod
    def _wrap(cls, native: Any) -> Animation:
        animation = cls.__new__(cls)
        animation._native = native
        animation._arkit_shapes = None
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
    def landmarks(self) -> torch.Tensor | None:
        """(T, 68, 3) displacements in metres, canonical frame, of which the motion was made; None where not known."""
        return self._native.landmarks

    @property
    def metadata(self) -> dict[str, Any]:
        """What the maker of the animation says: options, alignment, notices."""
        return json.loads(self._native.metadata_json)

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

    def save(
        self,
        path: str | os.PathLike[str],
        *,
        rig: str | BlendShapes = "pca",
        progress: Callable[[float], None] | None = None,
        **options: Any,
    ) -> SaveReport:
        """Writes the animation by the extension of ``path``, in any case, atomically.

        ``.npz`` holds everything (``numpy.load`` reads it); ``.glb``, ``.gltf`` and ``.usda`` morph targets and their
        weights, with the speech beside as ``NAME.speech.wav`` (inside too, of ``.glb``); ``.usdc``, ``.usd`` and
        ``.usdz`` the same as binary USD (``pip install 'freetalk[usd]'``); ``.pc2`` a cache of every vertex for
        Blender's Mesh Cache; ``folder/*.obj`` and ``folder/*.ply`` a numbered mesh per frame; ``.mp4`` and ``.webm``
        a rendered video with sound; ``.html`` a page that plays it in any browser, without a network; ``.csv`` (Live
        Link Face), ``.json`` (Audio2Face) and ``.arkit.npz`` ARKit's weights.

        Materials, textures, vertex colours and texture coordinates of the mesh's OBJ, PLY or glTF are kept; a glTF of
        a mesh that was read from glTF is that file with the motion added.

        Args:
            path: where to write.
            rig: what the targets of glTF and USD are. ``"pca"``: the fewest for the error; ``"arkit"``: ARKit's 51
                shapes by name, and what they leave as ``motion_0`` and on; or targets of your own, with weights.
            progress: called with the finished share in [0, 1]; may raise to stop.
            options: fields of ``SaveOptions`` (``morph_tolerance_mm=0.1``, ``compact=False`` ...); ``cache=True``
                for the points of every frame in USD; for video those of ``freetalk.viz.save_video``, for ``.html``
                those of ``freetalk.page.save_page``.

        Returns:
            Format, number of files, number and error of morph targets.

        Raises:
            ValueError: unknown extension or option, or ``rig="arkit"`` for an animation that no face made.
            RuntimeError: the path cannot be written.
        """
        suffix = Path(path).suffix.lower()
        if suffix in (".mp4", ".webm"):
            from freetalk.viz import save_video

            save_video(self, path, **options)
            return SaveReport(suffix[1:])
        if suffix == ".html":
            from freetalk.page import save_page

            save_page(self, path, **options)
            return SaveReport("html")
        if suffix in (".csv", ".json") or Path(path).name.lower().endswith(".arkit.npz"):
            from freetalk.exports import save_curves

            save_curves(self, path, **options)
            return SaveReport(suffix[1:])
        shapes = self._shapes(rig)
        if suffix in (".usd", ".usdc", ".usdz") or "cache" in options:
            from freetalk.exports import save_usd

            return save_usd(self, path, shapes=shapes, **options)
        return self._save(path, shapes, progress, **options)

    def _save(
        self,
        path: str | os.PathLike[str],
        shapes: BlendShapes | None = None,
        progress: Callable[[float], None] | None = None,
        **options: Any,
    ) -> SaveReport:
        """The formats of the C++ library."""
        given = {} if shapes is None else {"shapes": shapes}
        return self._native.save(path, SaveOptions(**options), **given, progress=progress)

    def _shapes(self, rig: str | BlendShapes) -> BlendShapes | None:
        if not isinstance(rig, str):
            return rig
        if rig == "pca":
            return None
        if rig != "arkit":
            raise ValueError(f"rig is '{rig}': use 'pca', 'arkit' or blend shapes")
        if self._arkit_shapes is None:
            raise ValueError(
                "rig='arkit' needs the face that the animation was made on: "
                "rig=talker.prepare(animation.mesh).blend_shapes(animation)"
            )
        return self._arkit_shapes(self)

    def on(self, mesh: Mesh) -> Animation:
        """The same motion on a mesh with the same vertices: to give it its file's materials again.

        Raises:
            ValueError: another number of vertices.
        """
        return Animation(
            mesh,
            self.displacements,
            fps=self.fps,
            audio=self.audio,
            metadata=self.metadata,
            metres_per_unit=self.frame.metres_per_unit,
            to_y_up=self.frame.to_y_up,
            head=self.head,
            landmarks=self.landmarks,
        )

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        mesh: Mesh | None = None,
        fps: float | None = None,
    ) -> Animation:
        """Reads what :meth:`save` wrote, and animations of morph targets of other programs.

        Args:
            path: ``.npz``, ``.glb``, ``.gltf``, USD, ``.pc2``, or a folder of OBJ or PLY files (``"frames/*.obj"`` as
                well). Only ``.npz`` brings back unit, axes and vertices as they were: glTF and USD are read in metres,
                +Y up, with a vertex for each texture coordinate in glTF.
            mesh: whose vertices a ``.pc2`` moves.
            fps: of a ``.pc2`` or a folder (30 unless told), or to sample a glTF at.

        Raises:
            ValueError: another extension, a ``.pc2`` without its mesh, or `fps` of a file that has its own.
            RuntimeError: the file is missing, truncated or of another content.
        """
        file = Path(path)
        suffix, native = file.suffix.lower(), _native.animation
        if fps and suffix in (".npz", ".usd", ".usda", ".usdc", ".usdz"):
            raise ValueError(
                f"'{path}' has its own frame rate: fps is of a .pc2, a folder or a glTF alone"
            )
        if suffix == ".npz":
            return cls._wrap(native.load_npz(path))
        if suffix in (".glb", ".gltf"):
            return cls._wrap(native.load_gltf(path, fps or 0.0))
        if suffix in (".usd", ".usda", ".usdc", ".usdz"):
            from freetalk.exports import load_usd

            return load_usd(path)
        if suffix == ".pc2":
            if mesh is None:
                raise ValueError(
                    f"'{path}' holds vertices alone: give mesh=, the mesh they belong to"
                )
            return cls._wrap(native.load_pc2(path, mesh, fps or 30.0))
        if file.is_dir() or file.stem == "*":
            return cls._wrap(
                native.load_sequence(file if file.is_dir() else file.parent, fps or 30.0)
            )
        raise ValueError(
            f"'{path}' is no animation: give .npz, .glb, .gltf, USD, .pc2 or a folder of OBJ or PLY files"
        )

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
            "source": mesh.source,
        }
        fields = {
            "fps": self.fps,
            "audio": self.audio,
            "metadata": self.metadata,
            "metres_per_unit": self.frame.metres_per_unit,
            "to_y_up": self.frame.to_y_up,
            "head": self.head,
            "landmarks": self.landmarks,
        }
        return _rebuild, (surface, self.displacements, fields)


def _rebuild(
    surface: dict[str, Any], displacements: torch.Tensor, fields: dict[str, Any]
) -> Animation:
    source = surface.pop("source")
    mesh = Mesh(**surface)
    mesh.source = source
    return Animation(mesh, displacements, **fields)


def load_animation(
    path: str | os.PathLike[str], *, mesh: Mesh | None = None, fps: float | None = None
) -> Animation:
    """See :meth:`Animation.load`."""
    return Animation.load(path, mesh=mesh, fps=fps)


def resample_motion(
    motion: torch.Tensor,
    from_fps: float,
    to_fps: float,
    num_frames: int,
    landmarks: torch.Tensor | None = None,
) -> torch.Tensor:
    """Catmull-Rom interpolation in time; frame t of either rate is at t / fps.

    Lips that close for a moment between two frames of the other rate would not be seen to: given the landmarks, the
    frame nearest to such a moment shows it.

    Args:
        motion: (T, ...) floating point.
        from_fps: rate of ``motion``.
        to_fps: rate of the result.
        num_frames: length of the result.
        landmarks: (T, 68, 3) displacements of the same frames, m; ``None``: every frame shows its own time.

    Returns:
        (num_frames, ...); held beyond the end of ``motion``.
    """
    return _native.animation.resample_motion(motion, from_fps, to_fps, num_frames, landmarks)


def morph_basis(
    displacements: torch.Tensor, tolerance: float, max_targets: int = 128
) -> tuple[torch.Tensor, torch.Tensor, float]:
    """A displacement sequence as few morph targets.

    Args:
        displacements: (T, V, 3) float32.
        tolerance: vertex error at which no further target is added.
        max_targets: at most so many.

    Returns:
        targets (K, V, 3), weights (T, K) in [0, 1], and the largest vertex error.
    """
    return _native.animation.morph_basis(displacements, tolerance, max_targets)
