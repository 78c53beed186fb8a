"""Several datasets as one: each keeps its meshes, its frame rate and its splits [FreeTalk Table 3]."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from freetalk.data.dataset import (
    FaceMesh,
    FloatArray,
    MotionDataset,
    MotionSequence,
    chosen,
)


class MixedDataset:
    """The union of datasets with names.

    Sequences, meshings and sources carry their dataset's name in front (``VOCASET/FLAME``); a source is
    the dataset's name alone where the dataset has only one, so shares are asked for as
    ``task.source_weights={VOCASET: 0.5, MEAD: 0.5}``.

    Args:
        parts: datasets by name.

    Raises:
        ValueError: none, or they disagree on emotions or sample rate.
    """

    def __init__(self, parts: Mapping[str, MotionDataset]) -> None:
        if not parts:
            raise ValueError("a mixture needs at least one dataset")
        self.parts = dict(parts)
        self.name = "+".join(self.parts)
        first = next(iter(self.parts.values()))
        self.emotions, self.sample_rate_hz = first.emotions, first.sample_rate_hz
        for name, part in self.parts.items():
            if (part.emotions, part.sample_rate_hz) != (self.emotions, self.sample_rate_hz):
                raise ValueError(
                    f"{name} has the emotions {part.emotions} at {part.sample_rate_hz} Hz, the first "
                    f"dataset {self.emotions} at {self.sample_rate_hz} Hz; datasets that are trained "
                    "together share the library's vocabulary"
                )
        self.fps = max(part.fps for part in self.parts.values())
        self._first_identity: dict[str, int] = {}
        self._owner: dict[str, tuple[str, MotionSequence]] = {}
        self._sequences: list[MotionSequence] = []
        identities = frames = 0
        for name, part in self.parts.items():
            self._first_identity[name] = identities
            identities += max(part.identities(), default=-1) + 1
            frames += self._take_over(name, part, frames)

    @property
    def fingerprint(self) -> str:
        """Changes with any of the parts."""
        joined = " ".join(f"{name}={part.fingerprint}" for name, part in self.parts.items())
        return hashlib.sha256(joined.encode()).hexdigest()[:16]

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Sequences of a split (all if ``None``) and of the given sources (all if ``None``)."""
        return chosen(self._sequences, split, sources)

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""
        name, own = self._owner[sequence.id]
        return self.parts[name].landmarks(own, start, stop)

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the sequence at ``sample_rate_hz``, (S,) float32 in [-1, 1]."""
        name, own = self._owner[sequence.id]
        return self.parts[name].audio(own)

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the faces of a split, those of each dataset after the ones before."""
        return [
            self._first_identity[name] + index
            for name, part in self.parts.items()
            for index in part.identities(split)
        ]

    def topologies(self, split: str | None = None) -> list[str]:
        """Names of the meshings of a split."""
        return [f"{name}/{t}" for name, part in self.parts.items() for t in part.topologies(split)]

    def num_vertices(self, topology: str) -> int:
        """Vertices V of a meshing."""
        part, own = self._meshing(topology)
        return self.parts[part].num_vertices(own)

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of every face of a split, the datasets in turn."""
        lists = [
            [
                (self._first_identity[name] + i, f"{name}/{t}")
                for i, t in part.faces(split, max_vertices)
            ]
            for name, part in self.parts.items()
        ]
        longest = max((len(pairs) for pairs in lists), default=0)
        return [pairs[turn] for turn in range(longest) for pairs in lists if turn < len(pairs)]

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face of an identity on a meshing of its dataset."""
        part, own = self._meshing(topology)
        mesh = self.parts[part].mesh(identity - self._first_identity[part], own)
        return dataclasses.replace(mesh, name=f"{part}/{mesh.name}", dataset=part)

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop) on a meshing, (T, V, 3) float32, m."""
        part, own = self._meshing(topology)
        name, original = self._owner[sequence.id]
        if name != part:
            raise ValueError(f"{sequence.id} belongs to {name}, it cannot move a face of {part}")
        return self.parts[part].vertex_displacements(own, original, start, stop)

    def describe(self) -> dict[str, Any]:
        """What each dataset says of itself."""
        return {
            "name": self.name,
            "datasets": {name: part.describe() for name, part in self.parts.items()},
        }

    def check(self) -> None:
        """Checks each dataset."""
        for part in self.parts.values():
            part.check()

    def _take_over(self, name: str, part: MotionDataset, first_frame: int) -> int:
        """Adds a dataset's sequences under its name; returns their frames."""
        sequences = part.sequences()
        several = len({s.source for s in sequences}) > 1
        for own in sequences:
            renamed = dataclasses.replace(
                own,
                id=f"{name}/{own.id}",
                source=f"{name}/{own.source}" if several else name,
                start_frame=own.start_frame + first_frame,
                identity=own.identity + self._first_identity[name],
                topology=None if own.topology is None else f"{name}/{own.topology}",
                dataset=name,
            )
            self._sequences.append(renamed)
            self._owner[renamed.id] = (name, own)
        return max((s.start_frame + s.num_frames for s in sequences), default=0)

    def _meshing(self, topology: str) -> tuple[str, str]:
        part, _, own = topology.partition("/")
        if part not in self.parts or not own:
            raise ValueError(f"no topology {topology!r} in {self.name}; known: {self.topologies()}")
        return part, own
