"""Sequences of speech and facial motion: one packed folder, several as one, or a part of them."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from freetalk.data.codes import HeadCodes, codes_of
from freetalk.data.emotions import EMOTIONS
from freetalk.data.errors import DatasetError
from freetalk.data.pack import FULL_SCALE, SAMPLE_RATE_HZ, FloatArray, Meshing, Pack
from freetalk.data.pose import Pose
from freetalk.data.sequences import (
    FaceEntry,
    FaceMesh,
    MotionSequence,
    faces_of,
    read_frames,
    sequences_of,
)
from freetalk.data.splits import SPLITS

#: The neutral face that factors of no joint ask for.
_NOWHERE = np.zeros((1, 3), np.float32)


class Dataset:
    """What training and evaluation read; lengths in metres, time in seconds, sound at 16 kHz.

    Attributes:
        name: of the dataset.
        fps: frames per second; where sequences differ, the highest (each says its own).
        sample_rate_hz: of :meth:`audio`.
        emotions: the vocabulary that the sequences' emotions index into.
        packs: the folders that are read, by the name of the dataset.
    """

    sample_rate_hz = SAMPLE_RATE_HZ
    emotions: tuple[str, ...] = EMOTIONS

    def __init__(self, pack: Pack, name: str = "", split: str = "") -> None:
        """Opens a packed folder.

        Args:
            pack: the folder.
            name: what to call it; by default as it calls itself.
            split: name of the split scheme; empty for the first.

        Raises:
            DatasetError: unknown split, emotion or identity.
        """
        manifest = pack.manifest
        self.name = name or str(manifest["name"])
        schemes = list(manifest["splits"])
        if split and split not in schemes:
            raise DatasetError(
                f"{pack.directory} has no split {split!r}; known: {', '.join(schemes)}"
            )
        self.packs: dict[str, Pack] = {self.name: pack}
        self._facts: dict[str, Any] = {**manifest["facts"], "split": {}}
        self._sequences: list[MotionSequence] = []
        if schemes:
            chosen = split or schemes[0]
            self._facts["split"] = {"name": chosen, "source": manifest["splits"][chosen]}
            self._sequences = sequences_of(pack, self.name, schemes.index(chosen))
        self._faces, self._meshings = faces_of(pack, self.name, self._sequences)

    @property
    def fps(self) -> float:
        """Frames per second; the highest where sequences differ."""
        return max(
            (s.fps for s in self._sequences), default=max(p.fps for p in self.packs.values())
        )

    @cached_property
    def fingerprint(self) -> str:
        """Changes with the data, the split, the rate and what is shown of it; names it in caches."""
        shown = [
            [pack.fingerprint for pack in self.packs.values()],
            [(s.id, s.split, s.source, s.fps, s.offset, s.num_frames) for s in self._sequences],
            [(face.own, sorted(face.splits)) for face in (*self._faces, *self._meshings.values())],
        ]
        return hashlib.sha256(json.dumps(shown).encode()).hexdigest()[:16]

    @property
    def expressions(self) -> tuple[str, ...]:
        """Names of the expressions whose weights move all faces alike; empty where packs have none or differ."""
        names = {pack.expressions for pack in self.packs.values()}
        return next(iter(names)) if len(names) == 1 else ()

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Sequences of a split (all splits if ``None``) and of the given sources (all if ``None``)."""
        return [
            s
            for s in self._sequences
            if (split is None or s.split == split) and (sources is None or s.source in sources)
        ]

    def scans(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Points (T, P, 3) of the surfaces of frames [start, stop) that are scans, m; (T, 0, 3) of others."""
        return read_frames(self.packs[sequence.dataset], "scans", sequence, start, stop)

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""
        return read_frames(self.packs[sequence.dataset], "landmarks", sequence, start, stop)

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop) on a meshing, (T, V, 3) float32, m.

        Raises:
            ValueError: the meshing is of another dataset.
        """
        meshing = self._meshing(topology)
        if meshing.dataset != sequence.dataset:
            raise ValueError(
                f"{sequence.id} belongs to {sequence.dataset}, it cannot move a face of {meshing.dataset}"
            )
        values = read_frames(self.packs[sequence.dataset], "motion", sequence, start, stop)
        if values.ndim == 3:
            return values
        pack = self.packs[sequence.dataset]
        data, neutral = pack.meshing(str(meshing.own)), _NOWHERE
        if not pack.moves_all:  # FLAME's jaw turns about a joint of the face
            neutral = data.neutral(pack.identities[int(self._faces[sequence.identity].own)])
        return data.displacements(values, neutral)

    def weights(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Weights of the ``expressions`` in frames [start, stop), (T, E) float32."""
        if self.expressions:
            return read_frames(self.packs[sequence.dataset], "motion", sequence, start, stop)
        stop = sequence.num_frames if stop is None else stop
        return np.zeros((stop - start, 0), np.float32)

    def head_codes(self) -> HeadCodes:
        """What the fitted codes of all sequences belong to.

        Raises:
            DatasetError: a dataset has none, or they are of several heads; says which.
        """
        found = {name: codes_of(pack) for name, pack in self.packs.items()}
        first = next(iter(found.values()))
        if first is None or any(one is None or one.head != first.head for one in found.values()):
            listed = ", ".join(
                f"{name}: {'none' if one is None else one.head}" for name, one in found.items()
            )
            raise DatasetError(
                f"codes of one head are needed, fitted by 'freetalk corpus codes'; found {listed}"
            )
        return first

    def codes(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Fitted codes of the parametric head in frames [start, stop), (T, Z) float32."""
        return read_frames(self.packs[sequence.dataset], "codes", sequence, start, stop)

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples, (S,) float32 in [-1, 1]; silence of its length where nothing was recorded."""
        if not sequence.has_sound:
            return np.zeros(round(sequence.num_frames / sequence.fps * SAMPLE_RATE_HZ), np.float32)
        first = sequence.first_sample
        samples = self.packs[sequence.dataset].audio.read(first, first + sequence.num_samples)
        return samples.astype(np.float32) / np.float32(FULL_SCALE)

    def phones(self, sequence: MotionSequence) -> list[tuple[float, float, str]]:
        """Phones as (start in s, end in s, ARPABET label); empty where none are known."""
        first, length = sequence.offset / sequence.fps, sequence.num_frames / sequence.fps
        known = self.packs[sequence.dataset].phones(sequence.name)
        shifted = [(start - first, end - first, label) for start, end, label in known]
        whole = sequence.offset == 0 and sequence.num_frames == sequence.stored_frames
        return known if whole else [p for p in shifted if p[1] > 0 and p[0] < length]

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the faces of a split."""
        return [i for i, face in enumerate(self._faces) if split is None or split in face.splits]

    def topologies(self, split: str | None = None) -> list[str]:
        """Names of the meshings of a split."""
        return [n for n, face in self._meshings.items() if split is None or split in face.splits]

    def num_vertices(self, topology: str) -> int:
        """Vertices V of a meshing."""
        meshing = self._meshing(topology)
        entries = self.packs[meshing.dataset].manifest["topologies"]
        return next(int(e["num_vertices"]) for e in entries if e["name"] == meshing.own)

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face of an identity on a meshing, the landmarks' mean at the origin."""
        meshing, face = self._meshing(topology), self._faces[identity]
        pack = self.packs[meshing.dataset]
        data = pack.meshing(str(meshing.own))
        entry = pack.manifest["identities"][int(face.own)]
        return FaceMesh(
            name=f"{meshing.dataset}/{entry['name']}/{meshing.own}",
            vertices=data.neutral(pack.identities[int(face.own)]),
            faces=data.faces,
            lip_mask=data.lip_mask,
            upper_face_mask=data.upper_face_mask,
            dataset=meshing.dataset,
            landmarks=data.landmarks,
        )

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of every face of a split, spread so that any prefix is varied.

        Of a dataset's faces, in round r meshing j meets identity r + j; datasets come in turn.

        Args:
            split: of both; all if ``None``.
            max_vertices: larger meshings are left out, 0 for no limit.
        """
        lists = []
        for name in self.packs:
            people = [i for i in self.identities(split) if self._faces[i].dataset == name]
            meshings = [
                t
                for t in self.topologies(split)
                if self._meshings[t].dataset == name
                and (max_vertices <= 0 or self.num_vertices(t) <= max_vertices)
            ]
            lists.append(
                [
                    (people[(turn + column) % len(people)], topology)
                    for turn in range(len(people))
                    for column, topology in enumerate(meshings)
                    if self._meshings[topology].identity
                    in (None, self._faces[people[(turn + column) % len(people)]].own)
                ]
            )
        longest = max((len(pairs) for pairs in lists), default=0)
        return [pairs[turn] for turn in range(longest) for pairs in lists if turn < len(pairs)]

    def source_frame(self, sequence: MotionSequence) -> tuple[Pose, FloatArray]:
        """Unit and axes of the files that a sequence was imported from, and where its face lay there.

        Returns:
            From the files' coordinates to ours, and (3,) the place of our origin in the files' unit.
        """
        pack = self.packs[sequence.dataset]
        entry = pack.manifest["identities"][int(self._faces[sequence.identity].own)]
        return Pose.of(pack.manifest["facts"]), np.array(entry["origin"], np.float32)

    def drawn(self) -> tuple[str, tuple[str, ...], FloatArray] | None:
        """A dataset whose faces any weights of named expressions move, its expressions, and what they do.

        Returns:
            Its name, E names, and (E, 68, 3) landmark displacements at weight 1, m; ``None`` where no dataset
            has such faces.
        """
        for name, pack in self.packs.items():
            if pack.moves_all and "landmark_basis" in (extras := pack.extras()):
                return name, pack.expressions, extras["landmark_basis"]
        return None

    def meshing(self, topology: str) -> Meshing:
        """The arrays of a meshing."""
        found = self._meshing(topology)
        return self.packs[found.dataset].meshing(str(found.own))

    def displacements_of(self, topology: str, weights: FloatArray) -> FloatArray:
        """(T, V, 3) m: what expression weights (T, E) do to a meshing of :meth:`drawn`'s dataset."""
        return self.meshing(topology).displacements(weights, _NOWHERE)

    def describe(self) -> dict[str, Any]:
        """What results say of the data: kind, unit, frame rate, split, template, masks by count and hash."""
        counts = {split: len(self.sequences(split)) for split in SPLITS}
        return {"name": self.name, **self._facts, "fps": self.fps, "sequences": counts}

    def at(self, fps: float) -> Dataset:
        """The same data at a frame rate: landmarks and vertices are resampled as they are read."""
        return self.select([s.at(fps) for s in self._sequences])

    def select(
        self,
        sequences: Iterable[MotionSequence],
        *,
        name: str = "",
        identities: Mapping[str, int] | None = None,
        topologies: Mapping[str, Sequence[str]] | None = None,
        facts: Mapping[str, Any] | None = None,
    ) -> Dataset:
        """A part of the data.

        Args:
            sequences: of this dataset, as they are, or clips of them.
            name: what the part is called; its faces and sequences say that they belong to it.
            identities: most faces of a split.
            topologies: meshings of a split.
            facts: what :meth:`describe` says of it in place of the whole's.
        """
        part = copy.copy(self)
        part.__dict__.pop("fingerprint", None)
        part._sequences = list(sequences)
        if identities is not None:
            kept = {s: set(self.identities(s)[: identities.get(s)]) for s in SPLITS}
            part._faces = [
                dataclasses.replace(f, splits=frozenset(s for s in f.splits if i in kept[s]))
                for i, f in enumerate(self._faces)
            ]
        if topologies is not None:
            splits = {
                t: frozenset(s for s in SPLITS if t in topologies.get(s, ()))
                for t in self._meshings
            }
            part._meshings = {
                t: dataclasses.replace(m, splits=splits[t])
                for t, m in self._meshings.items()
                if splits[t]
            }
        if facts is not None:
            part._facts = dict(facts)
        if name:
            part._rename(name)
        return part

    @staticmethod
    def mixture(parts: Mapping[str, Dataset]) -> Dataset:
        """The union of datasets with names; each keeps its meshes, its frame rate and its splits.

        Sequences, meshings and sources carry their dataset's name in front (``VOCASET/FLAME``); a source is
        the dataset's name alone where the dataset has only one, so shares are asked for as
        ``task.source_weights={VOCASET: 0.5, MEAD: 0.5}``.

        Raises:
            ValueError: none is given.
        """
        if not parts:
            raise ValueError("a mixture needs at least one dataset")
        mixed = copy.copy(next(iter(parts.values())))
        mixed.__dict__.pop("fingerprint", None)
        mixed.name = "+".join(parts)
        mixed._facts = {"datasets": {name: part.describe() for name, part in parts.items()}}
        mixed.packs, mixed._sequences, mixed._faces, mixed._meshings = {}, [], [], {}
        for name, given in parts.items():
            part = given.select(given.sequences(), name=name)
            several = len({s.source for s in part._sequences}) > 1
            first = len(mixed._faces)
            mixed._sequences += [
                dataclasses.replace(
                    s,
                    id=f"{name}/{s.id}",
                    source=f"{name}/{s.source}" if several else name,
                    identity=s.identity + first,
                    topology=None if s.topology is None else f"{name}/{s.topology}",
                )
                for s in part._sequences
            ]
            mixed._faces += part._faces
            mixed._meshings |= {f"{name}/{t}": m for t, m in part._meshings.items()}
            mixed.packs |= part.packs
        return mixed

    def _rename(self, name: str) -> None:
        """Calls the one dataset of this object otherwise."""
        ((_, pack),) = self.packs.items()
        self.name, self.packs = name, {name: pack}
        self._sequences = [dataclasses.replace(s, dataset=name) for s in self._sequences]
        self._faces = [dataclasses.replace(f, dataset=name) for f in self._faces]
        self._meshings = {
            t: dataclasses.replace(m, dataset=name) for t, m in self._meshings.items()
        }

    def _meshing(self, topology: str) -> FaceEntry:
        if topology not in self._meshings:
            known = ", ".join(self._meshings) or "none"
            raise ValueError(f"no topology {topology!r} in {self.name}; known: {known}")
        return self._meshings[topology]
