"""Ground truth that is a split of a dataset which freetalk opens."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from freetalk.data import (
    NUM_LANDMARKS,
    DatasetError,
    Mask,
    MotionDataset,
    MotionSequence,
    RegisteredDataset,
)
from freetalk.data.landmarks import INNER_LIP_PAIRS
from freetalk.evaluate.masks import Pairs, landmark_masks, landmark_pairs
from freetalk.evaluate.motion_files import FloatArray, MotionFile, Phones, guess_kind

LANDMARKS = "landmarks"


@dataclass
class DatasetTruth:
    """A split of a dataset on one of its meshings, or its landmarks.

    Attributes:
        dataset: what was opened.
        split: ``train``, ``val`` or ``test``.
        topology: a meshing, ``landmarks``, or ``None`` for the only one.
    """

    dataset: MotionDataset
    split: str
    topology: str | None
    names: list[str] = field(init=False)

    def __post_init__(self) -> None:
        self._sequences = {s.id: s for s in self.dataset.sequences(self.split)}
        if not self._sequences:
            raise DatasetError(f"{self.dataset.name} has no sequence in its split {self.split!r}")
        self.names = list(self._sequences)
        self.fps = float(self.dataset.fps)
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
        if isinstance(self.dataset, RegisteredDataset) and self.dataset.template.landmarks:
            upper, lower = INNER_LIP_PAIRS
            indices = self.dataset.template.landmarks.indices
            self.lip_pairs = (indices[list(upper)], indices[list(lower)])

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
        neutral, own, rotation = self._frame_of(self._sequences[name])
        own = scale or file.metres_per_unit or own
        if kind == "auto" and file.is_displacement is not None:
            kind = "displacements" if file.is_displacement else "vertices"
        if kind == "auto":
            kind = guess_kind(file.frames[0], neutral, own, name)
        metres = file.frames * np.float32(own)
        if kind == "vertices":
            if neutral is None:
                raise ValueError(f"{name}: landmarks must be displacements from the neutral face")
            metres = metres - neutral
        turned: FloatArray = metres if rotation is None else np.matmul(metres, rotation.T)
        return turned

    def phones(self, name: str) -> Phones:
        """Phones of a sequence, where the dataset knows them."""
        known = getattr(self.dataset, "phones", None)
        return [] if known is None else list(known(self._sequences[name]))

    def audio(self, name: str) -> tuple[FloatArray, float] | None:
        """Samples and rate."""
        sequence = self._sequences[name]
        if sequence.audio is None:
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

    def _frame_of(
        self, sequence: MotionSequence
    ) -> tuple[FloatArray | None, float, FloatArray | None]:
        """Neutral face in metres and the files' axes, metres per unit, rotation to our axes."""
        dataset = self.dataset
        if isinstance(dataset, RegisteredDataset):
            rotation = np.asarray(dataset.pose.rotation, dtype=np.float32)
            if self.topology == LANDMARKS:
                return None, dataset.pose.scale, rotation
            neutral = dataset.neutral(sequence) * np.float32(dataset.pose.scale)
            return neutral, dataset.pose.scale, rotation
        if self.topology == LANDMARKS:
            return None, 1.0, None
        return dataset.mesh(sequence.identity, str(self.topology)).vertices, 1.0, None
