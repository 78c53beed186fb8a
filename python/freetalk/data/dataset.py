"""What training and evaluation need to know of a motion dataset, whatever its layout on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from freetalk import _native
from freetalk.data.emotions import EMOTIONS

__all__ = [
    "EMOTIONS",
    "NUM_LANDMARKS",
    "BoolArray",
    "FaceMesh",
    "FloatArray",
    "MotionDataset",
    "MotionSequence",
    "chosen",
]

FloatArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

NUM_LANDMARKS: int = _native.core.NUM_LANDMARKS


@dataclass(frozen=True)
class MotionSequence:
    """One take: where its frames lie, what is heard and which affect it shows.

    Attributes:
        id: unique name within the dataset.
        split: ``train``, ``val`` or ``test``.
        source: where the motion comes from, e.g. ``facegood``, ``synthetic``, ``rom``, ``rest``.
        take: recording that the sequence was cut from.
        audio: absolute path of the 16 kHz audio; ``None`` where there is none.
        start_frame: first frame in the packed arrays.
        num_frames: number of frames T.
        emotion: index into the dataset's ``emotions``.
        intensity: real number in [1, 3].
        identity: index of the face that was recorded or drawn.
        voice: speaker.
        text: transcript where known.
        fps: frames per second of its motion.
        topology: meshing that it was recorded on, the only one whose vertices it moves (of
            ``identity``); ``None`` where it moves every face of its dataset.
        dataset: name of the dataset.
    """

    id: str
    split: str
    source: str
    take: str
    audio: Path | None
    start_frame: int
    num_frames: int
    emotion: int
    intensity: float
    identity: int
    voice: str | None
    text: str | None
    fps: float = 30.0
    topology: str | None = None
    dataset: str = ""


def chosen(
    sequences: Sequence[MotionSequence], split: str | None, sources: Sequence[str] | None
) -> list[MotionSequence]:
    """Sequences of a split (all if ``None``) and of the given sources (all if ``None``)."""
    return [
        s
        for s in sequences
        if (split is None or s.split == split) and (sources is None or s.source in sources)
    ]


@dataclass(frozen=True)
class FaceMesh:
    """A neutral face in the canonical frame, with the regions that the metrics need.

    Attributes:
        name: ``identity/topology``, for messages.
        vertices: (V, 3) float32, m.
        faces: (F, 3) int64.
        lip_mask: (V,) bool.
        upper_face_mask: (V,) bool.
        dataset: name of the dataset; its sequences move this face.
    """

    name: str
    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    lip_mask: BoolArray
    upper_face_mask: BoolArray
    dataset: str = ""


@runtime_checkable
class MotionDataset(Protocol):
    """The one interface that training and evaluation use; lengths in metres, time in seconds.

    Attributes:
        name: of the dataset.
        fps: frames per second; where sequences differ, the highest (each says its own).
        sample_rate_hz: of :meth:`audio`.
        emotions: the vocabulary that the sequences' emotions index into.
    """

    name: str
    fps: float
    sample_rate_hz: int
    emotions: tuple[str, ...]

    @property
    def fingerprint(self) -> str:
        """Changes when the data does; names it in caches."""

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Sequences of a split (all splits if ``None``) and of the given sources (all if ``None``)."""

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the sequence at ``sample_rate_hz``, (S,) float32 in [-1, 1]."""

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the faces of a split."""

    def topologies(self, split: str | None = None) -> list[str]:
        """Names of the meshings of a split."""

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face of an identity on a meshing."""

    def num_vertices(self, topology: str) -> int:
        """Vertices V of a meshing."""

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of every face of a split, spread so that any prefix is varied.

        Args:
            split: of both; all if ``None``.
            max_vertices: larger meshings are left out, 0 for no limit.
        """

    def describe(self) -> dict[str, Any]:
        """What results say of the data: names, unit, frame rate, split, masks by count and hash."""

    def check(self) -> None:
        """Looks for missing files before a training starts; raises what is wrong by name."""

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop) on a meshing, (T, V, 3) float32, m."""
