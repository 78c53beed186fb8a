"""Adapter of the open corpus: memory-mapped motion, audio by file, meshes as linear factors."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import soundfile

from freetalk._files import content_hash
from freetalk.data.dataset import (
    NUM_LANDMARKS,
    BoolArray,
    FaceMesh,
    FloatArray,
    MotionSequence,
    chosen,
)
from freetalk.data.index_files import index_hash

_FORMAT = "freetalk-open-corpus"
_REBUILD = "run `freetalk corpus build --out DIR` to make it anew"
_SPLITS = ("train", "val", "test")


class OpenCorpus:
    """Reads a folder made by ``freetalk corpus build``.

    Args:
        directory: folder that holds ``manifest.json``.

    Raises:
        FileNotFoundError: the folder is no corpus, or a file is missing.
        ValueError: a file disagrees with the manifest.
    """

    def __init__(self, directory: str | Path) -> None:
        self.directory = Path(directory).resolve()
        self.manifest = self._read_manifest()
        self.name = self.directory.name
        self.fps = float(self.manifest["fps"])
        self.sample_rate_hz = int(self.manifest["sample_rate_hz"])
        self.emotions: tuple[str, ...] = tuple(self.manifest["emotions"])
        self.expressions: tuple[str, ...] = tuple(self.manifest["expressions"])
        self._sequences = [self._sequence(entry) for entry in self.manifest["sequences"]]
        self._landmarks = self._array("landmarks.npy")
        self._weights = self._array("weights.npy")
        self._identities = self._array("identities.npy")
        self._phones: dict[str, list[tuple[float, float, str]]] | None = None
        self._check_arrays()
        # Bound per object, so that two corpora never share a meshing of the same name.
        self._topology = lru_cache(maxsize=16)(self._load_topology)
        self._basis = lru_cache(maxsize=16)(self._load_basis)

    @cached_property
    def fingerprint(self) -> str:
        """Changes with the manifest, the motion, the faces and meshings, and the sizes and times of the
        recordings, which are too many to read."""
        arrays = ("landmarks.npy", "weights.npy", "identities.npy")
        read = [self.directory / name for name in ("manifest.json", *arrays)]
        read += [self._topology_path(name) for name in self.topologies()]
        digest = hashlib.sha256(content_hash(*(path for path in read if path.is_file())).encode())
        for path in sorted({s.audio for s in self._sequences if s.audio is not None}):
            state = path.stat()
            digest.update(f"{path.name} {state.st_size} {state.st_mtime_ns}".encode())
        return digest.hexdigest()[:16]

    def sequences(
        self, split: str | None = None, sources: Sequence[str] | None = None
    ) -> list[MotionSequence]:
        """Sequences of a split (all if ``None``) and of the given sources (all if ``None``)."""
        return chosen(self._sequences, split, sources)

    def landmarks(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Landmark displacements of frames [start, stop), (T, 68, 3) float32, m."""
        return self._frames(self._landmarks, sequence, start, stop)

    def weights(
        self, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Expression weights of frames [start, stop), (T, E) float32."""
        return self._frames(self._weights, sequence, start, stop)

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the sequence, (S,) float32; silence of its length where it has no audio."""
        if sequence.audio is None:
            samples = round(sequence.num_frames / self.fps * self.sample_rate_hz)
            return np.zeros(samples, dtype=np.float32)
        wave, rate = soundfile.read(sequence.audio, dtype="float32")
        if rate != self.sample_rate_hz:
            raise ValueError(
                f"{sequence.audio} has {rate} Hz, the manifest says {self.sample_rate_hz}; "
                + _REBUILD
            )
        mono = wave if wave.ndim == 1 else wave.mean(axis=1)
        return np.ascontiguousarray(mono, dtype=np.float32)

    def phones(self, sequence: MotionSequence) -> list[tuple[float, float, str]]:
        """Phones as (start in s, end in s, ARPABET label); empty where none are known."""
        if self._phones is None:
            path = self.directory / "phones.json"
            raw = json.loads(path.read_text()) if path.is_file() else {}
            self._phones = {
                name: [(float(a), float(b), str(label)) for a, b, label in items]
                for name, items in raw.items()
            }
        if sequence.audio is None:
            return []
        return self._phones.get(sequence.audio.relative_to(self.directory).as_posix(), [])

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the faces of a split."""
        entries = self.manifest["identities"]
        return [int(e["index"]) for e in entries if split is None or e["split"] == split]

    def topologies(self, split: str | None = None) -> list[str]:
        """Names of the meshings of a split."""
        entries = self.manifest["topologies"]
        return [str(e["name"]) for e in entries if split is None or e["split"] == split]

    def num_vertices(self, topology: str) -> int:
        """Vertices V of a meshing."""
        return int(self._entry(topology)["num_vertices"])

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of a split: in round r meshing j meets identity r + j."""
        identities = self.identities(split)
        topologies = [
            name
            for name in self.topologies(split)
            if max_vertices <= 0 or self.num_vertices(name) <= max_vertices
        ]
        return [
            (identities[(turn + column) % len(identities)], topology)
            for turn in range(len(identities))
            for column, topology in enumerate(topologies)
        ]

    def describe(self) -> dict[str, Any]:
        """What results say of the data: size, seed, and each meshing's masks by count and hash."""
        return {
            "name": self.name,
            "kind": "open",
            "unit": "m",
            "fps": self.fps,
            **{key: self.manifest.get(key) for key in ("size", "seed")},
            "sequences": {split: len(self.sequences(split)) for split in _SPLITS},
            "topologies": {
                topology: {
                    mask: {"count": int(flags.sum()), "sha256": index_hash(np.flatnonzero(flags))}
                    for mask, flags in self._masks(topology).items()
                }
                for topology in self.topologies()
            },
        }

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face ``neutral + identities[identity] . identity_basis`` on a meshing."""
        data = self._topology(topology)
        coefficients = np.asarray(self._identities[identity], dtype=np.float32)
        modes = data["identity_basis"].astype(np.float32)
        offset = np.tensordot(coefficients, modes[: len(coefficients)], axes=1)
        return FaceMesh(
            name=f"{identity}/{topology}",
            vertices=(data["neutral"] + offset).astype(np.float32),
            faces=data["faces"].astype(np.int64),
            lip_mask=data["lip_mask"].astype(bool),
            upper_face_mask=data["upper_face_mask"].astype(bool),
            dataset=self.name,
        )

    def expression_basis(self, topology: str) -> FloatArray:
        """Vertex displacement of each expression at weight 1, (E, V, 3) float32, m."""
        return self._basis(topology)

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop), (T, V, 3) float32, m."""
        return self.displacements_of(topology, self.weights(sequence, start, stop))

    def displacements_of(self, topology: str, weights: FloatArray) -> FloatArray:
        """Vertex displacements of expression weights (T, E), (T, V, 3) float32, m."""
        basis = self._basis(topology)
        flat = weights @ basis.reshape(len(basis), -1)
        return flat.reshape(len(weights), -1, 3)

    def landmark_basis(self) -> tuple[FloatArray, BoolArray]:
        """Landmark displacement of each expression at weight 1, recovered from the sequences.

        Landmarks are linear in the weights, so least squares over all frames gives them back exactly
        for every expression that the sequences move apart from the others.

        Returns:
            (E, 68, 3) float32 m, and (E,) bool: which expressions are determined.
        """
        weights = np.asarray(self._weights, dtype=np.float64)
        landmarks = np.asarray(self._landmarks, dtype=np.float64).reshape(len(weights), -1)
        values, vectors = np.linalg.eigh(weights.T @ weights)  # ascending
        kept = values > 1e-6 * max(float(values[-1]), 1e-12)
        inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
        basis = inverse @ (weights.T @ landmarks)
        determined = np.square(vectors[:, kept]).sum(axis=1) > 1 - 1e-6
        return basis.reshape(-1, NUM_LANDMARKS, 3).astype(np.float32), determined

    def check(self) -> None:
        """Opens every file that the manifest names.

        Raises:
            FileNotFoundError: names the first ten missing files.
        """
        wanted = [s.audio for s in self._sequences if s.audio is not None]
        wanted += [self._topology_path(name) for name in self.topologies()]
        missing = [path for path in dict.fromkeys(wanted) if not path.is_file()]
        if missing:
            names = ", ".join(str(path) for path in missing[:10])
            raise FileNotFoundError(
                f"{self.directory} lacks {len(missing)} of {len(wanted)} files: {names}; {_REBUILD}"
            )
        for name in self.topologies():
            self._topology(name)

    def _read_manifest(self) -> dict[str, Any]:
        path = self.directory / "manifest.json"
        if not path.is_file():
            raise FileNotFoundError(f"{self.directory} holds no manifest.json; {_REBUILD}")
        manifest: dict[str, Any] = json.loads(path.read_text())
        if manifest.get("format") != _FORMAT or manifest.get("version") != 1:
            raise ValueError(f"{path} is not of format {_FORMAT} version 1; {_REBUILD}")
        return manifest

    def _sequence(self, entry: dict[str, Any]) -> MotionSequence:
        if entry["split"] not in _SPLITS:
            raise ValueError(f"sequence {entry['id']}: unknown split {entry['split']!r}")
        if entry["emotion"] not in self.emotions:
            raise ValueError(f"sequence {entry['id']}: unknown emotion {entry['emotion']!r}")
        return MotionSequence(
            id=str(entry["id"]),
            split=entry["split"],
            source=entry["source"],
            take=str(entry.get("take") or entry["id"]),
            audio=self.directory / entry["audio"] if entry["audio"] else None,
            start_frame=int(entry["start_frame"]),
            num_frames=int(entry["num_frames"]),
            emotion=self.emotions.index(entry["emotion"]),
            intensity=float(entry["intensity"]),
            identity=int(entry.get("identity") or 0),
            voice=entry.get("voice"),
            text=entry.get("text"),
            fps=self.fps,
            dataset=self.name,
        )

    def _array(self, name: str) -> npt.NDArray[Any]:
        path = self.directory / name
        if not path.is_file():
            raise FileNotFoundError(f"{path} is missing; {_REBUILD}")
        array: npt.NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        return array

    def _check_arrays(self) -> None:
        total = max((s.start_frame + s.num_frames for s in self._sequences), default=0)
        if self._landmarks.shape[1:] != (NUM_LANDMARKS, 3) or len(self._landmarks) < total:
            raise ValueError(
                f"{self.directory}/landmarks.npy has shape {self._landmarks.shape}, the manifest "
                f"needs ({total}, {NUM_LANDMARKS}, 3); {_REBUILD}"
            )
        if self._weights.shape != (len(self._landmarks), len(self.expressions)):
            raise ValueError(
                f"{self.directory}/weights.npy has shape {self._weights.shape}, expected "
                f"({len(self._landmarks)}, {len(self.expressions)}); {_REBUILD}"
            )

    def _frames(
        self, array: npt.NDArray[Any], sequence: MotionSequence, start: int, stop: int | None
    ) -> FloatArray:
        end = sequence.num_frames if stop is None else min(stop, sequence.num_frames)
        first = sequence.start_frame
        return np.array(array[first + start : first + end], dtype=np.float32)

    def _topology_path(self, name: str) -> Path:
        return self.directory / str(self._entry(name)["file"])

    def _masks(self, name: str) -> dict[str, npt.NDArray[Any]]:
        with np.load(self._topology_path(name), allow_pickle=False) as archive:
            return {mask: archive[mask] > 0 for mask in ("lip_mask", "upper_face_mask")}

    def _entry(self, name: str) -> dict[str, Any]:
        for entry in self.manifest["topologies"]:
            if entry["name"] == name:
                return dict(entry)
        raise ValueError(f"no topology {name!r} in {self.directory}; known: {self.topologies()}")

    def _load_topology(self, name: str) -> dict[str, npt.NDArray[Any]]:
        path = self._topology_path(name)
        if not path.is_file():
            raise FileNotFoundError(f"{path} is missing; {_REBUILD}")
        with np.load(path, allow_pickle=False) as archive:
            return {
                key: archive[key]
                for key in ("neutral", "faces", "identity_basis", "lip_mask", "upper_face_mask")
            }

    def _load_basis(self, name: str) -> FloatArray:
        with np.load(self._topology_path(name), allow_pickle=False) as archive:
            return archive["expression_basis"].astype(np.float32)
