"""What training and evaluation need to know of a motion dataset, whatever its layout on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]

NUM_LANDMARKS = 68

#: Canonical order of the affect vocabulary; emotion codes index into it.
EMOTIONS: tuple[str, ...] = (
    "neutral",
    "afraid",
    "ashamed",
    "angry",
    "disgust",
    "happy",
    "sad",
    "drunk",
    "ill",
    "suspicious",
    "pleased",
    "upset",
    "surprise",
    "contempt",
)


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


@dataclass(frozen=True)
class FaceMesh:
    """A neutral face in the canonical frame, with the regions that the metrics need.

    Attributes:
        name: ``identity/topology``, for messages.
        vertices: (V, 3) float32, m.
        faces: (F, 3) int64.
        lip_mask: (V,) bool.
        upper_face_mask: (V,) bool.
    """

    name: str
    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    lip_mask: BoolArray
    upper_face_mask: BoolArray


@runtime_checkable
class MotionDataset(Protocol):
    """The one interface that training and evaluation use; lengths in metres, time in seconds."""

    fps: float
    sample_rate_hz: int
    emotions: tuple[str, ...]

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

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop) on a meshing, (T, V, 3) float32, m."""
