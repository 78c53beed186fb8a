"""A part of a dataset as a dataset: some sequences, cut into clips, at another frame rate, on some meshings."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from freetalk.data import FaceMesh, MotionDataset, MotionSequence, interpolate_frames
from freetalk.data.dataset import FloatArray, chosen


@dataclass(frozen=True)
class ViewOptions:
    """What of a dataset a view shows.

    Attributes:
        fps: frames per second; 0 keeps the dataset's.
        clip_frames: sequences are cut into clips of at most so many frames; 0 leaves them whole.
        min_frames: shorter clips are left out.
        every: of the train split, every n-th clip is taken.
        limits: most clips of a split, spread evenly over it; absent: all.
        identities: most faces of a split; absent: all.
    """

    fps: float = 0.0
    clip_frames: int = 0
    min_frames: int = 1
    every: int = 1
    limits: Mapping[str, int] = field(default_factory=dict)
    identities: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Clip:
    """A sequence of the dataset, and the clip's first frame in the view's frame rate."""

    own: MotionSequence
    first: int


class DatasetView:
    """A part of a dataset that satisfies ``MotionDataset``.

    Args:
        base: the dataset.
        name: what the view is called; its faces and sequences say that they belong to it.
        options: what it shows.
        keep: which of the dataset's sequences belong to it; ``None``: all.
        topologies: meshings by split, for a dataset whose sequences move any meshing; ``None``: its own.

    Raises:
        ValueError: no sequence is left.
    """

    def __init__(
        self,
        base: MotionDataset,
        name: str,
        options: ViewOptions,
        keep: Callable[[MotionSequence], bool] | None = None,
        topologies: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self.base, self.name, self.options = base, name, options
        self.sample_rate_hz, self.emotions = base.sample_rate_hz, base.emotions
        self.fps = options.fps or base.fps
        self._meshings = topologies
        self._clips: dict[str, _Clip] = {}
        self._sequences: list[MotionSequence] = []
        for split in ("train", "val", "test"):
            own = [s for s in base.sequences(split) if keep is None or keep(s)]
            clips = [clip for sequence in own for clip in self._cut(sequence)]
            clips = clips[:: options.every] if split == "train" else clips
            limit = options.limits.get(split, len(clips))
            at = np.unique(np.linspace(0, len(clips) - 1, min(limit, len(clips))).round())
            self._sequences += [clips[int(index)] for index in at]
        if not self._sequences:
            raise ValueError(f"no sequence of {base.name} belongs to {name}")

    @property
    def fingerprint(self) -> str:
        """Changes with the dataset and with what is shown of it."""
        shown = json.dumps(
            [self.base.fingerprint, self.name, self.fps, [s.id for s in self._sequences]]
        )
        return hashlib.sha256(shown.encode()).hexdigest()[:16]

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Clips of a split (all splits if ``None``) and of the given sources (all if ``None``)."""
        return chosen(self._sequences, split, sources)

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""
        return self._resampled(self.base.landmarks, sequence, start, stop)

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop) on a meshing, (T, V, 3) float32, m."""

        def read(own: MotionSequence, first: int, last: int) -> FloatArray:
            return self.base.vertex_displacements(topology, own, first, last)

        return self._resampled(read, sequence, start, stop)

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the clip at ``sample_rate_hz``, (S,) float32 in [-1, 1]."""
        clip = self._clips[sequence.id]
        first, last = clip.first / self.fps, (clip.first + sequence.num_frames) / self.fps
        wave = self.base.audio(clip.own)
        return wave[round(first * self.sample_rate_hz) : round(last * self.sample_rate_hz)]

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the faces of a split."""
        own = self.base.identities(split)
        return own[: self.options.identities.get(split or "", len(own))]

    def topologies(self, split: str | None = None) -> list[str]:
        """Names of the meshings of a split."""
        if self._meshings is None:
            return self.base.topologies(split)
        splits = [split] if split else list(self._meshings)
        return list(dict.fromkeys(t for one in splits for t in self._meshings[one]))

    def num_vertices(self, topology: str) -> int:
        """Vertices V of a meshing."""
        return self.base.num_vertices(topology)

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face of an identity on a meshing."""
        return dataclasses.replace(self.base.mesh(identity, topology), dataset=self.name)

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of every face of a split, spread so that any prefix is varied."""
        if self._meshings is None:
            return self.base.faces(split, max_vertices)
        people = self.identities(split)
        kept = [
            t
            for t in self.topologies(split)
            if max_vertices <= 0 or self.num_vertices(t) <= max_vertices
        ]
        return [
            (people[(turn + column) % len(people)], topology)
            for turn in range(len(people))
            for column, topology in enumerate(kept)
        ]

    def faces_of(self, split: str) -> list[tuple[MotionSequence, int, str]]:
        """(clip, identity, topology) that each clip of a split is scored on: the recorded face, or in turn."""
        people, meshings = self.identities(split), self.topologies(split)
        if not people and any(s.topology is None for s in self.sequences(split)):
            raise ValueError(f"{self.base.name} has no face in its split {split}")
        return [
            (s, s.identity, s.topology)
            if s.topology is not None
            else (s, people[at % len(people)], meshings[at % len(meshings)])
            for at, s in enumerate(self.sequences(split))
        ]

    def describe(self) -> dict[str, Any]:
        """What results say of it: the dataset, frame rate, clips and meshings by split."""
        splits = ("train", "val", "test")
        return {
            "name": self.name,
            "of": self.base.name,
            "fps": self.fps,
            "clips": {split: len(self.sequences(split)) for split in splits},
            "frames": {s: sum(clip.num_frames for clip in self.sequences(s)) for s in splits},
            "topologies": {split: self.topologies(split) for split in splits},
        }

    def check(self) -> None:
        """Looks for missing files of the dataset."""
        self.base.check()

    def _cut(self, own: MotionSequence) -> list[MotionSequence]:
        total = int((own.num_frames - 1) * self.fps / own.fps + 1e-6) + 1
        length = self.options.clip_frames or total
        clips = []
        for first in range(0, total, length):
            frames = min(length, total - first)
            if frames < self.options.min_frames:
                continue
            name = own.id if length >= total else f"{own.id}-{first // length}"
            clips.append(
                dataclasses.replace(
                    own, id=name, num_frames=frames, fps=self.fps, dataset=self.name
                )
            )
            self._clips[name] = _Clip(own, first)
        return clips

    def _resampled(
        self,
        read: Callable[[MotionSequence, int, int], FloatArray],
        sequence: MotionSequence,
        start: int,
        stop: int | None,
    ) -> FloatArray:
        """Frames at the view's rate, linear between those of the dataset."""
        clip = self._clips[sequence.id]
        last = sequence.num_frames if stop is None else min(stop, sequence.num_frames)
        at = (clip.first + np.arange(start, last)) * (clip.own.fps / self.fps)
        first = int(at[0])
        frames = read(clip.own, first, min(int(at[-1]) + 2, clip.own.num_frames))
        return interpolate_frames(frames, at - first)
