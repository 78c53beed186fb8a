"""A face that is not where a head in its own file would be: turned any way, of any unit, on a body.

The part of the mesh around the face goes through the pipeline, in the canonical frame; its motion comes back in the
mesh's own unit and axes, fading out with the distance from the landmarks. The rest of the mesh stays still.
"""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk.animation import Animation
from freetalk.geometry import Alignment, Similarity
from freetalk.mesh import Mesh
from freetalk.talker.report import FoundAlignment

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

Points = NDArray[np.float64]
#: 68 vertices, 68 points (68, 3) in the mesh's own unit and axes, or a file that names them.
Landmarks: TypeAlias = "ArrayLike | str | os.PathLike[str]"

#: Motion is whole nearer to a landmark than the first (m), and none beyond the second.
REACH_M = (0.07, 0.12)
#: Surface within this (m) of a landmark is taken for the head; its far side is what alignment and parts need.
_HEAD_M = 0.25
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_LARGEST_MISTAKE = np.log(1.35)
#: A pose within this angle of the mesh's own axes is said in them.
_UPRIGHT = np.cos(np.deg2rad(20.0))
#: Landmarks and shape of a human face agree within these.
_LARGEST_TURN_DEG, _LARGEST_SHIFT_M = 15.0, 0.025
#: Results larger than this lie in a file, where a folder for one is given.
_SCRATCH_BYTES = 64 << 20


@dataclass(frozen=True)
class Placement:
    """Where the face of a mesh is, and what moves with it.

    Attributes:
        mesh: as it was given.
        to_canonical: from its unit and axes to the canonical frame, m.
        landmarks: (68, 3) where they are, canonical frame, m.
        how: who found it, one phrase.
        guessed: whether it was found rather than told.
    """

    mesh: Mesh
    to_canonical: Similarity
    landmarks: Points
    how: str
    guessed: bool

    @cached_property
    def _home(self) -> Points:
        """(V, 3) the mesh in the canonical frame."""
        return self.to_canonical.apply(np.asarray(self.mesh.vertices))

    @cached_property
    def _distance(self) -> Points:
        """(V,) m, to the nearest landmark."""
        nearest = np.full(len(self._home), np.inf)
        for landmark in self.landmarks:
            nearest = np.minimum(nearest, np.linalg.norm(self._home - landmark, axis=1))
        return nearest

    @cached_property
    def kept(self) -> NDArray[np.int64]:
        """(K,) vertices of the polygons that belong to the head, rising."""
        near = self._distance < _HEAD_M
        inside = [polygon for polygon in self._polygons() if near[polygon].all()]
        if not inside:
            raise ValueError(f"{self.mesh.name}: no surface lies around the landmarks")
        return np.unique(np.concatenate([np.asarray(polygon) for polygon in inside]))

    @cached_property
    def reach(self) -> NDArray[np.float32]:
        """(K,) share of the motion that a kept vertex makes."""
        near, far = REACH_M
        u = np.clip((self._distance[self.kept] - near) / (far - near), 0, 1)
        return np.asarray(1 - u * u * (3 - 2 * u), dtype=np.float32)

    def _polygons(self) -> list[Any]:
        return self.mesh.polygons or np.asarray(self.mesh.faces).tolist()

    def head(self) -> Mesh:
        """The kept part in the canonical frame, m."""
        new = np.full(len(self._home), -1)
        new[self.kept] = np.arange(len(self.kept))
        polygons = [new[polygon].tolist() for polygon in self._polygons()]
        whole = [polygon for polygon in polygons if min(polygon) >= 0]
        return Mesh(self._home[self.kept], whole, name=self.mesh.name)

    def spread(
        self,
        motion: torch.Tensor,
        out: torch.Tensor | None = None,
        scratch_dir: str | None = None,
    ) -> torch.Tensor:
        """Motion of the head (T, K, 3), canonical frame, m, as that of the whole mesh (T, V, 3), its own unit and axes.

        Args:
            motion: float32.
            out: to be filled and returned.
            scratch_dir: folder for a nameless file that holds a large result in place of memory.

        Raises:
            ValueError: ``out`` is of another form.
        """
        shape = (len(motion), len(self._home), 3)
        if out is None:
            result = _zeros(shape, scratch_dir)
        elif (
            out.shape == shape and out.dtype == torch.float32 and out.is_contiguous() and out.is_cpu
        ):
            result = out.zero_()
        else:
            raise ValueError(
                f"out must be {list(shape)}, contiguous, float32 and on the CPU; found {list(out.shape)}"
            )
        pose = self.to_canonical
        back = torch.from_numpy(np.asarray(pose.rotation / pose.scale, dtype=np.float32))
        share, kept = torch.from_numpy(self.reach)[:, None], torch.from_numpy(self.kept)
        for frame, moved in zip(result, motion):
            frame[kept] = share * (moved @ back)
        return result

    def move(self, head: torch.Tensor) -> torch.Tensor:
        """(V, 3) float32 vertices of the whole mesh from the head's (K, 3), canonical frame, m."""
        rest = torch.from_numpy(self._home[self.kept].astype(np.float32))
        whole = torch.from_numpy(np.asarray(self.mesh.vertices, dtype=np.float32))
        return whole + self.spread((head - rest)[None])[0]

    def animation(
        self,
        native: Any,
        found: FoundAlignment,
        out: torch.Tensor | None = None,
        scratch_dir: str | None = None,
    ) -> Animation:
        """The animation of the whole mesh from that of its head, ``found`` as :meth:`alignment` says."""
        pose = self.to_canonical
        metadata = json.loads(native.metadata_json)
        metadata["alignment"] |= {
            "summary": found.summary,
            "unit": found.unit,
            "up": found.up,
            "forward": found.forward,
            "to_canonical": {
                "scale": pose.scale,
                "rotation": np.asarray(pose.rotation).tolist(),
                "translation": np.asarray(pose.translation).ravel().tolist(),
            },
        }
        return Animation(
            self.mesh,
            self.spread(native.displacements, out, scratch_dir),
            fps=native.fps,
            audio=native.audio,
            metadata=metadata,
            metres_per_unit=_UNITS.get(found.unit, pose.scale),
            to_y_up=self._axes()[2],
            head=self.head_motion(native.head),
            landmarks=native.landmarks,
        )

    def head_motion(self, head: torch.Tensor | None) -> torch.Tensor | None:
        """Rigid motion (..., 4, 4) of the canonical frame as that of the mesh, in its own unit and axes."""
        if head is None:
            return None
        pose, to = self.to_canonical, torch.eye(4, dtype=torch.float64)
        to[:3, :3] = torch.from_numpy(pose.scale * np.asarray(pose.rotation))
        to[:3, 3] = torch.from_numpy(np.array(pose.translation).ravel())
        return torch.linalg.inv(to) @ head @ to

    def alignment(self, head: Any) -> FoundAlignment:
        """How the mesh lies; ``head`` is the alignment of :meth:`head` with the mean face."""
        unit = _unit_of(self.to_canonical.scale)
        up, forward, _ = self._axes()
        axes = f"{up.upper()} up, {forward.upper()} forward"
        summary = f"{self.how}: unit {unit}, {axes}; fit residual {1000 * head.residual_m:.1f} mm"
        still = len(self._home) - len(self.kept)
        if still:
            summary += f"; {still} vertices are no part of the head and stay still"
        return FoundAlignment(
            *(self.to_canonical, unit, up, forward, self.guessed),
            *(head.residual_m, head.normal_degrees, head.face_like, summary),
        )

    def doubts(self, head: Any) -> list[str]:
        """What a user should know of the alignment of :meth:`head` with the mean face: that they disagree."""
        moved = head.to_canonical
        cosine = np.clip((np.trace(np.asarray(moved.rotation)) - 1) / 2, -1, 1)
        degrees, shift = np.rad2deg(np.arccos(cosine)), np.linalg.norm(moved.translation)
        if degrees < _LARGEST_TURN_DEG and shift < _LARGEST_SHIFT_M:
            return []
        return [
            f"the head's shape lies {degrees:.0f} degrees and {1000 * shift:.0f} mm off its landmarks, and motion "
            "follows the shape: look at 'freetalk mesh landmarks --picture'"
        ]

    def _axes(self) -> tuple[str, str, Points]:
        """Nearest axes of the mesh up and forward, and the rotation to +Y up, +Z out of the face: by whole axes
        where the head is upright in them."""
        rotation = np.asarray(self.to_canonical.rotation)
        names, rows = [], []
        for row in rotation[1:]:
            axis = int(np.abs(row).argmax())
            names.append(("-" if row[axis] < 0 else "+") + "xyz"[axis])
            rows.append(np.sign(row[axis]) * np.eye(3)[axis])
        upright = min(rotation[k + 1] @ rows[k] for k in (0, 1)) > _UPRIGHT
        exact = np.stack([np.cross(*rows), *rows]) if upright else rotation
        return names[0], names[1], exact


def _unit_of(scale: float) -> str:
    name, factor = min(_UNITS.items(), key=lambda each: abs(np.log(scale / each[1])))
    return name if abs(np.log(scale / factor)) < _LARGEST_MISTAKE else "arbitrary"


def _zeros(shape: tuple[int, ...], scratch_dir: str | None) -> torch.Tensor:
    if scratch_dir is None or 4 * np.prod(shape) < _SCRATCH_BYTES:
        return torch.zeros(shape)
    with tempfile.TemporaryFile(dir=scratch_dir) as file:
        return torch.from_numpy(np.memmap(file, dtype=np.float32, mode="w+", shape=shape))


def place(mesh: Mesh, landmarks: Landmarks) -> Placement:
    """Where a face lies that is told by its landmarks.

    Raises:
        ValueError: other than 68 landmarks, or a vertex that the mesh lacks.
    """
    from freetalk.data import read_landmarks
    from freetalk.faces import home_pose

    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if isinstance(landmarks, str | os.PathLike):
        found = read_landmarks(Path(landmarks), faces, len(vertices))
        points = np.einsum("kcd,kc->kd", vertices[found.vertices], found.weights.astype(np.float64))
    else:
        given = np.asarray(landmarks)
        if given.shape == (68,) and given.dtype.kind in "iu":
            if given.min() < 0 or given.max() >= len(vertices):
                raise ValueError(
                    f"landmarks name vertices from {given.min()} to {given.max()}, {mesh.name} has "
                    f"{len(vertices)}"
                )
            given = vertices[given]
        if given.shape != (68, 3) or not np.isfinite(given).all():
            raise ValueError(
                f"landmarks must be 68 vertices or points (68, 3), found {given.dtype} {given.shape}"
            )
        points = given.astype(np.float64)
    pose = home_pose(points, np.ones(len(points)))
    return Placement(mesh, pose, pose.apply(points), "landmarks as given", guessed=False)


def find_face(mesh: Mesh, alignment: Alignment) -> Placement:
    """Where the face of a mesh is whose shape leaves that in doubt.

    Raises:
        ValueError: nothing on it looks like a face.
    """
    from freetalk.faces import find_landmarks, home_pose

    found = find_landmarks(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), alignment, name=mesh.name
    )
    pose = home_pose(found.positions, found.confidence)
    return Placement(mesh, pose, pose.apply(found.positions), found.summary, guessed=True)
