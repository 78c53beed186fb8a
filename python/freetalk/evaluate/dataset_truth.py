"""Ground truth that is a split of a dataset which freetalk opens."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from freetalk.data import NUM_LANDMARKS, Dataset, DatasetError, Mask, MotionSequence
from freetalk.data.landmarks import INNER_LIP_PAIRS
from freetalk.data.pose import Pose
from freetalk.evaluate.masks import Pairs, landmark_masks, landmark_pairs
from freetalk.evaluate.motion_files import FloatArray, MotionFile, Origin, Phones, guess_kind

LANDMARKS = "landmarks"


@dataclass
class DatasetTruth:
    """A split of a dataset on one of its meshings, or its landmarks.

    Attributes:
        dataset: what was opened.
        split: ``train``, ``val`` or ``test``.
        topology: a meshing, ``landmarks``, or ``None`` for the only one.
    """

    dataset: Dataset
    split: str
    topology: str | None
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self._sequences = {s.id: s for s in self.dataset.sequences(self.split)}
        if not self._sequences:
            raise DatasetError(f"{self.dataset.name} has no sequence in its split {self.split!r}")
        self.names = list(self._sequences)
        self.fps: float | None = float(self.dataset.fps)
        self.up: tuple[float, float, float] | None = None  # motion comes out with +y up
        if self.topology is None:
            known = self.dataset.topologies(self.split)
            if len(known) != 1:
                raise ValueError(
                    f"{self.dataset.name} has the meshings {', '.join(known)}: choose one with "
                    f"--topology, or the 68 points with --topology {LANDMARKS}"
                )
            self.topology = known[0]
        first = next(iter(self._sequences.values()))
        self.masks: dict[str, Mask] = {}
        self.lip_pairs: Pairs | None = None
        if self.topology == LANDMARKS:
            self.num_vertices = NUM_LANDMARKS
            self.masks, self.lip_pairs = landmark_masks(), landmark_pairs()
            return
        mesh = self.dataset.mesh(first.identity, self.topology)
        self.num_vertices = len(mesh.vertices)
        source = f"{self.dataset.name}, {self.topology}"
        for key, flags in (("lips", mesh.lip_mask), ("upper", mesh.upper_face_mask)):
            if flags.any():
                self.masks[key] = Mask(np.flatnonzero(flags).astype(np.int64), source)
        if mesh.landmarks is not None:
            upper, lower = INNER_LIP_PAIRS
            self.lip_pairs = (mesh.landmarks[list(upper)], mesh.landmarks[list(lower)])

    @property
    def has_neutral(self) -> bool:
        """Datasets know their neutral faces."""
        return True

    def motion(self, name: str) -> FloatArray:
        """(T, V, 3) m, canonical axes."""
        sequence = self._sequences[name]
        if self.topology == LANDMARKS:
            return self.dataset.landmarks(sequence)
        return self.dataset.vertex_displacements(str(self.topology), sequence)

    def place(self, file: MotionFile, name: str, kind: str, scale: float | None) -> FloatArray:
        """A prediction in the dataset's frame: its files' unit and axes, or metres."""
        file.check_fits(self.fps, self.up)
        pose, neutral = self._frame_of(self._sequences[name])
        own = pose.scale
        if scale is not None or file.stated.metres_per_unit is not None:
            own = file.scale(scale, "--pred-unit")
        if kind == "auto" and file.is_displacement is not None:
            kind = "displacements" if file.is_displacement else "vertices"
        if kind == "auto":
            metres = None if neutral is None else neutral * np.float32(pose.scale)
            kind = guess_kind(file.frames[0], metres, own, name)
        frames = file.frames if own == pose.scale else file.frames * np.float32(own / pose.scale)
        if kind == "vertices":
            if neutral is None:
                raise ValueError(f"{name}: landmarks must be displacements from the neutral face")
            frames = frames - neutral
        return pose.apply(frames)  # as the dataset does it, so that its own files score 0

    def origin(self, name: str) -> Origin:
        """Speaker and take of a sequence."""
        return origin_of(self._sequences[name])

    def phones(self, name: str) -> Phones:
        """Phones of a sequence, where the dataset knows them."""
        return self.dataset.phones(self._sequences[name])

    def audio(self, name: str) -> tuple[FloatArray, float] | None:
        """Samples and rate."""
        sequence = self._sequences[name]
        if not sequence.has_sound:
            return None
        return self.dataset.audio(sequence), float(self.dataset.sample_rate_hz)

    def emotion(self, name: str) -> str | None:
        """The label of a sequence."""
        return self.dataset.emotions[self._sequences[name].emotion]

    def describe(self) -> dict[str, Any]:
        """What the dataset says of itself, split and meshing."""
        return {
            **self.dataset.describe(),
            "layout": "dataset",
            "split_scored": self.split,
            "topology": self.topology,
            "vertices": self.num_vertices,
        }

    def _frame_of(self, sequence: MotionSequence) -> tuple[Pose, FloatArray | None]:
        """From the source's unit and axes to ours; the neutral face in theirs, which landmarks lack."""
        pose, origin = self.dataset.source_frame(sequence)
        if self.topology == LANDMARKS:
            return pose, None
        mesh = self.dataset.mesh(sequence.identity, str(self.topology))
        return pose, pose.undo(mesh.vertices) + origin


def origin_of(sequence: MotionSequence) -> Origin:
    """Speaker and take of a sequence; recordings of a source that names no voice have one speaker."""
    return Origin(sequence.voice or sequence.source, sequence.take)
