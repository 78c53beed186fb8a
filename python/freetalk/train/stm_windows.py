"""Windows of motion on the faces that they can move: any face of the open corpus, else the recorded one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data import Dataset, MotionSequence
from freetalk.train.sequences import SequenceSampler, present_weights
from freetalk.train.stm_meshes import Face, random_weights
from freetalk.train.stm_sculpts import Sculpts

FloatArray = npt.NDArray[np.float32]
_Key = tuple[str, int, str]


@dataclass(frozen=True)
class Window:
    """Motion of consecutive frames on one face.

    Attributes:
        mesh: index of the face.
        landmarks: (T, 68, 3) displacements, m.
        target: (T, V, 3) displacements of the face's vertices, m; none, (T, 0, 3), where frames are scans.
        scan: (T, P, 3) points of each frame's surface, m; none where vertices are known.
    """

    mesh: int
    landmarks: FloatArray
    target: FloatArray
    scan: FloatArray


class FaceWindows:
    """Draws windows from the sequences of a split that can move one of the faces.

    Args:
        corpus: where sequences and vertices come from.
        faces: the faces.
        split: of the sequences.
        source_weights: share of each source; ``random`` is drawn combinations of the open corpus's
            expressions. Sources that are not there are left out. Empty takes all sources in
            proportion to their length.
        frames: T.
        sculpts: draw other motion of the same expressions; None leaves it as it is.
        sculpted: share of the windows of which they do.

    Raises:
        ValueError: no sequence can move any of the faces.
    """

    def __init__(
        self,
        corpus: Dataset,
        faces: Sequence[Face],
        split: str,
        source_weights: dict[str, float],
        frames: int,
        sculpts: Sculpts | None = None,
        sculpted: float = 0.0,
    ) -> None:
        self.corpus, self.frames = corpus, frames
        self._sculpts, self._sculpted = sculpts, sculpted
        self._faces = list(faces)
        self._by_key: dict[_Key, list[int]] = {}
        for index, mesh in enumerate(self._faces):
            for key in ((mesh.dataset, -1, ""), (mesh.dataset, mesh.identity, mesh.topology)):
                self._by_key.setdefault(key, []).append(index)
        movable = [s for s in corpus.sequences(split) if _key(s) in self._by_key]
        if not movable:
            raise ValueError(
                f"no {split} sequence of {corpus.name} moves one of the {len(self._faces)} faces "
                "taken; raise task.num_meshes or task.max_vertices"
            )
        self._of_mesh: dict[int, SequenceSampler] = {}
        expressive = ["random"] if "random" in source_weights and self._find_expressions() else []
        weights = present_weights([*(s.source for s in movable), *expressive], source_weights)
        total = sum(weights.values())
        self._random_share = weights.pop("random", 0.0) / total if total else 0.0
        self.sampler = SequenceSampler(movable, weights)

    def draw(self, rng: np.random.Generator) -> Window:
        """A window of a drawn sequence, or of drawn expressions, on a face that it moves."""
        if rng.random() < self._random_share:
            return self._drawn_expressions(rng)
        return self.on_any(self.sampler.draw(rng), rng)

    def on_any(
        self, sequence: MotionSequence, rng: np.random.Generator, first: int | None = None
    ) -> Window:
        """A window of a sequence, at a given or a drawn place, on a drawn one of the faces that it moves."""
        fitting = self._by_key[_key(sequence)]
        return self.of(sequence, fitting[int(rng.integers(len(fitting)))], rng, first)

    def draw_on(self, mesh: int, rng: np.random.Generator) -> Window:
        """A window of a drawn sequence on a given face."""
        return self.of(self._sampler_of(mesh).draw(rng), mesh, rng)

    def first_on(self, mesh: int) -> MotionSequence:
        """The first sequence that moves a face."""
        return self._sampler_of(mesh).sequences[0]

    def of(
        self,
        sequence: MotionSequence,
        mesh: int,
        rng: np.random.Generator,
        first: int | None = None,
    ) -> Window:
        """A window of a sequence that begins at frame `first`, or at a drawn one."""
        drawn = int(rng.integers(0, max(1, sequence.num_frames - self.frames + 1)))
        start = drawn if first is None else first
        stop = start + self.frames
        face = self._faces[mesh]
        if self._is_sculpted(face, rng):
            return self._sculpture(mesh, self.corpus.weights(sequence, start, stop), rng)
        landmarks = self.corpus.landmarks(sequence, start, stop)
        scan = self.corpus.scans(sequence, start, stop)
        if scan.shape[1] > 0:
            return self._scanned(mesh, landmarks, scan)
        moved = self.corpus.vertex_displacements(face.topology, sequence, start, stop)
        return self._window(mesh, landmarks, moved)

    def _sampler_of(self, mesh: int) -> SequenceSampler:
        if mesh not in self._of_mesh:
            own = [s for s in self.sampler.sequences if mesh in self._by_key[_key(s)]]
            if not own:
                face = self._faces[mesh]
                raise ValueError(f"no sequence moves {face.topology} of identity {face.identity}")
            self._of_mesh[mesh] = SequenceSampler(own, {})
        return self._of_mesh[mesh]

    def _find_expressions(self) -> bool:
        """Looks for faces that show any weights of expressions."""
        found = self.corpus.drawn()
        if found is None or (found[0], -1, "") not in self._by_key:
            return False
        name, self._expressions, self._basis = found
        self._expressive = self._by_key[name, -1, ""]
        return True

    def _drawn_expressions(self, rng: np.random.Generator) -> Window:
        weights = random_weights(rng, self.frames, len(self._expressions))
        mesh = self._expressive[int(rng.integers(len(self._expressive)))]
        face = self._faces[mesh]
        if self._is_sculpted(face, rng):
            return self._sculpture(mesh, weights, rng)
        moved = self.corpus.displacements_of(face.topology, weights)
        return self._window(mesh, np.tensordot(weights, self._basis, axes=1), moved)

    def _is_sculpted(self, face: Face, rng: np.random.Generator) -> bool:
        known = self._sculpts is not None and face.dataset == self._sculpts.dataset
        return known and rng.random() < self._sculpted

    def _sculpture(self, mesh: int, weights: FloatArray, rng: np.random.Generator) -> Window:
        """A window of expressions as another sculpt of the face has them."""
        assert self._sculpts is not None
        face = self._faces[mesh]
        whole = self.corpus.mesh(face.identity, face.topology)
        return self._window(mesh, *self._sculpts.motion(rng, face.topology, whole, weights))

    def _window(self, mesh: int, landmarks: npt.NDArray[Any], moved: npt.NDArray[Any]) -> Window:
        """Motion (T, 68, 3) and (T, V, 3) of a face as the corpus has it, on what was made of the face."""
        face = self._faces[mesh]
        if face.bend is not None:
            whole = self.corpus.mesh(face.identity, face.topology)
            landmarks = face.bend.motion(face.bend.landmarks, landmarks)
            moved = face.bend.motion(whole.vertices, moved)
        none = np.zeros((len(landmarks), 0, 3), np.float32)
        return Window(
            mesh, landmarks.astype(np.float32), _left(face, moved.astype(np.float32)), none
        )

    def _scanned(self, mesh: int, landmarks: FloatArray, scan: FloatArray) -> Window:
        """Landmarks' motion (T, 68, 3) and scans (T, P, 3) of a face, on what was made of the face."""
        bend = self._faces[mesh].bend
        if bend is not None:
            landmarks = bend.motion(bend.landmarks, landmarks).astype(np.float32)
            scan = bend(scan).astype(np.float32)
        return Window(mesh, landmarks, np.zeros((len(landmarks), 0, 3), np.float32), scan)


def _left(face: Face, displacements: FloatArray) -> FloatArray:
    """(T, V', 3) of the vertices that a crop has left, from those of the whole meshing."""
    return displacements if face.kept is None else displacements[:, face.kept]


def _key(sequence: MotionSequence) -> _Key:
    """Which faces a sequence moves: those of its dataset, or the one it was recorded on."""
    if sequence.topology is None:
        return (sequence.dataset, -1, "")
    return (sequence.dataset, sequence.identity, sequence.topology)
