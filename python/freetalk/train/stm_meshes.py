"""The faces that the landmarks-to-mesh stage sees: meshes with their operators, moved at random."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor
from tqdm import tqdm

from freetalk.data import NUM_LANDMARKS, Dataset
from freetalk.geometry import SurfaceOperators, surface_operators
from freetalk.stm import LandmarkFollower
from freetalk.train.progress import notice
from freetalk.train.stm_cuts import FaceCuts
from freetalk.train.stm_landmarks import FaceLandmarks
from freetalk.train.stm_sculpts import Bend

#: Bytes of a cache folder that nothing empties: the faces of a large dataset must not drive each other out.
_UNLIMITED = 1 << 62
_SEED = 70


@dataclass(frozen=True)
class Face:
    """What of a corpus a prepared face is.

    Attributes:
        identity: index in the corpus.
        topology: meshing in the corpus.
        dataset: name of the dataset, whose sequences move it.
        kept: (V,) the meshing's vertices that are left after a crop; None where all are.
        bend: what gave the face other proportions than the corpus's; None where it has those.
    """

    identity: int
    topology: str
    dataset: str
    kept: npt.NDArray[np.int64] | None = None
    bend: Bend | None = None


@dataclass(frozen=True)
class PreparedMesh:
    """A neutral face ready for the network.

    Attributes:
        face: what it was made of.
        positions: (V, 3) float32, m.
        operators: of the vertices divided by the model's ``length_scale``, float32.
        lip_mask: (V,) bool.
        faces: (F, 3) triangles.
        follower: of its landmarks; None where they are not asked for.
        landmarks: (68,) vertices, where they are known and all are left.
    """

    face: Face
    positions: Tensor
    operators: SurfaceOperators
    lip_mask: Tensor
    faces: npt.NDArray[np.int64]
    follower: LandmarkFollower | None = None
    landmarks: Tensor | None = None

    @property
    def num_bytes(self) -> int:
        """Memory of its arrays, without what PoissonNet and Jacobian fields solve with."""
        own = self.operators
        tensors = [self.positions, self.lip_mask, own.mass, own.evecs, own.normals, own.frames]
        size = sum(tensor.nbytes for tensor in (*tensors, *own.gradients.tensors()))
        follows = 0 if self.follower is None else NUM_LANDMARKS * self.positions.nbytes // 3
        return int(size + follows)


class PreparedFaces:
    """Faces of a split, in the order of ``corpus.faces``; those that were used last stay in memory.

    Each is prepared once at the beginning, which brings its operators into the disk cache, and again whenever it
    is asked for and has made room for others.

    Attributes:
        faces: what they are made of; loader workers need no more.

    Args:
        corpus: the dataset.
        split: ``train``, ``val`` or ``test``.
        count: how many, 0 for all.
        max_vertices: larger faces are left out, 0 for no limit; where all are larger, all are taken.
        prepare: makes one of an identity, a topology and the ``index`` of the face, always the same.
        most_bytes: memory that they may take together, of which one face is always kept; 0 for no limit.

    Raises:
        ValueError: the split has no faces or no meshings.
    """

    def __init__(
        self,
        corpus: Dataset,
        split: str,
        count: int,
        max_vertices: int,
        prepare: Callable[..., PreparedMesh],
        most_bytes: int = 0,
    ) -> None:
        small = corpus.faces(split, max_vertices)
        pairs = small or corpus.faces(split)
        if pairs and not small:
            notice(f"no face of {corpus.name} has at most {max_vertices} vertices: all are taken")
        if not pairs:
            raise ValueError(f"{corpus.name} has no faces or no meshings in its {split} split")
        self._pairs = pairs[: count or len(pairs)]
        self._prepare, self._most_bytes = prepare, most_bytes
        self._kept: OrderedDict[int, PreparedMesh] = OrderedDict()
        self._bytes = 0
        indices = tqdm(range(len(self._pairs)), desc=f"{split} operators", unit="mesh")
        self.faces = [self[index].face for index in indices]

    def __len__(self) -> int:
        return len(self._pairs)

    def __getitem__(self, index: int) -> PreparedMesh:
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        identity, topology = self._pairs[index]
        self._kept[index] = mesh = self._prepare(identity, topology, index=index)
        self._bytes += mesh.num_bytes
        while self._bytes > self._most_bytes > 0 and len(self._kept) > 1:
            self._bytes -= self._kept.popitem(last=False)[1].num_bytes
        return mesh


@dataclass(frozen=True)
class Placement:
    """A similarity: points move to ``scale * (rotation @ x) + translation``."""

    rotation: Tensor  # (3, 3)
    translation: Tensor  # (3,)
    scale: float

    def moved(self, points: Tensor) -> Tensor:
        """Points (..., 3) at their new place."""
        return self.turned(points) + self.translation

    def turned(self, vectors: Tensor) -> Tensor:
        """Displacements (..., 3), which know no translation."""
        return self.scale * (vectors @ self.rotation.T)

    def operators(self, operators: SurfaceOperators) -> SurfaceOperators:
        """Operators of the moved surface, without solving anything again."""
        return operators.scaled(self.scale).turned(self.rotation)


def random_placement(
    rng: np.random.Generator,
    rotation_deg: float,
    translation_m: float,
    scale_range: float,
    device: torch.device,
) -> Placement:
    """A small rotation about a random axis, a shift, a change of size."""
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    angle = np.deg2rad(rotation_deg) * rng.uniform(-1, 1)
    rotation = Rotation.from_rotvec(angle * axis).as_matrix()
    return Placement(
        torch.tensor(rotation, dtype=torch.float32, device=device),
        torch.tensor(
            rng.uniform(-translation_m, translation_m, 3), dtype=torch.float32, device=device
        ),
        float(1 + rng.uniform(-scale_range, scale_range)),
    )


def prepare_mesh(
    corpus: Dataset,
    identity: int,
    topology: str,
    length_scale: float,
    k_eig: int,
    cache_dir: str | Path = "",
    device: torch.device | None = None,
    cuts: FaceCuts | None = None,
    index: int = 0,
    landmarks: FaceLandmarks | None = None,
    bends: float = 0.0,
) -> PreparedMesh:
    """A corpus face with its operators, from the disk cache where they are known.

    A `cache_dir` of its own keeps all that is put there, the user's only what was used last. With `cuts` it loses
    what they take from the `index`-th face, and a share `bends` of such faces gets other proportions. With `landmarks` it follows them: in training as certain as they may be, else where they are.
    """
    device = device or torch.device("cpu")
    mesh = corpus.mesh(identity, topology)
    kept, bend, follower = None, None, None
    rng = np.random.default_rng([_SEED, index])
    if landmarks is not None:
        whole = mesh.vertices.astype(np.float64)
        places = landmarks.on(topology, mesh).of(whole)
        if rng.random() < bends:
            bend = Bend(rng, places)
            places = bend(places)
            mesh = replace(mesh, vertices=bend(whole).astype(np.float32))
    left = cuts.of(mesh, index) if cuts is not None else None
    if left is not None:
        kept, faces = left
        mesh = replace(
            mesh,
            vertices=mesh.vertices[kept],
            faces=faces,
            lip_mask=mesh.lip_mask[kept],
            upper_face_mask=mesh.upper_face_mask[kept],
            landmarks=None,
        )
    if landmarks is not None:
        drawn = rng if cuts is not None else None
        follower = landmarks.follower(mesh.vertices, mesh.faces, places, drawn).to(device)
    own: dict[str, Any] = {"cache": cache_dir, "max_cache_bytes": _UNLIMITED} if cache_dir else {}
    operators: Any = surface_operators(
        mesh.vertices.astype(np.float64) / length_scale,
        mesh.faces,
        k=k_eig,
        name=mesh.name,
        **own,
    )
    return PreparedMesh(
        face=Face(identity, topology, mesh.dataset, kept, bend),
        positions=torch.from_numpy(mesh.vertices).to(device),
        operators=operators.to(dtype=torch.float32, device=str(device)),
        lip_mask=torch.from_numpy(mesh.lip_mask).to(device),
        faces=mesh.faces,
        follower=follower,
        landmarks=None if mesh.landmarks is None else torch.from_numpy(mesh.landmarks).to(device),
    )


def random_weights(
    rng: np.random.Generator, frames: int, num_expressions: int
) -> npt.NDArray[np.float32]:
    """Sparse combinations of expressions that change smoothly, (T, E) in [0, 1]."""
    weights = np.zeros((frames, num_expressions), dtype=np.float32)
    count = int(rng.integers(1, 9))
    active = rng.choice(num_expressions, size=min(count, num_expressions), replace=False)
    times = np.arange(frames) / 30.0
    for column in active:
        level, swing = rng.uniform(0, 0.6), rng.uniform(0, 0.4)
        hertz, phase = rng.uniform(0.3, 4.0), rng.uniform(0, 2 * np.pi)
        wave = level + swing * np.sin(2 * np.pi * hertz * times + phase)
        weights[:, column] = np.clip(wave, 0, 1)
    return weights
