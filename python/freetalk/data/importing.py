"""Turns a public release, or a folder of one's own, into the packed layout; take by take, so that it may be stopped."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.errors import (
    DatasetError,
    LayoutError,
    MissingTemplateError,
    NotFiniteError,
    ShortAudioError,
    VertexCountError,
)
from freetalk.data.index_files import Landmarks
from freetalk.data.pack import FULL_SCALE, SAMPLE_RATE_HZ, FloatArray, Meshing
from freetalk.data.pack_writer import PackedTake, PackWriter
from freetalk.data.pose import Pose, find_pose
from freetalk.data.releases import Release, Take, open_release
from freetalk.data.resampling import resample_frames
from freetalk.data.scans import sampled_scans, scan_arrays
from freetalk.data.splits import SplitScheme, schemes_of

#: Motion that outlasts its sound by less is cut (recorders stop a little apart); more is an error.
SHORT_AUDIO_S = 0.25
#: Frame rates from this one on are decimated towards 30, as public code does.
_DECIMATED_FROM_FPS = 50.0
_PROBED = 32

Array = npt.NDArray[Any]
Progress = Callable[[Iterable[Take]], Iterable[Take]]


def import_dataset(
    kind: str,
    source: str | Path,
    out: str | Path,
    *,
    name: str = "",
    fps: float = 0.0,
    unit: str = "auto",
    progress: Progress = iter,
) -> Path:
    """Packs a release. A take that is wrong is left out and named in the manifest; the others go on.

    A call that was stopped goes on where it was; one that is finished does nothing. Nothing appears at `out`
    before all is on the disk.

    Args:
        kind: one of ``freetalk.data.releases.KINDS``, or ``auto``.
        source: its folder, which is only read.
        out: the folder to make.
        name: what results call the data; by default as its folder states, else as `out` is called.
        fps: frames per second of the result; 0 keeps the release's, every second frame of 60.
        unit: length unit of the files: m, cm, mm, in, or ``auto``.
        progress: wraps the takes, such as ``tqdm``.

    Returns:
        `out`.

    Raises:
        DatasetError: what all takes need is missing or wrong; no take is usable; `out` holds something else.
        OSError: the disk is full or fails; the same call goes on when it is mended.
    """
    source_of = Source(open_release(kind, source), fps, unit)
    release, out = source_of.release, Path(out)
    called = name or release.name or out.name
    key = {"name": called, "source": str(release.directory), "content": source_of.fingerprint}
    with PackWriter(out, key) as writer:
        if writer.complete:
            return out
        for take_name, reason in release.excluded.items():
            if not writer.knows(take_name):
                writer.exclude(take_name, reason)
        for take in progress([take for take in release.takes if not writer.knows(take.id)]):
            try:
                packed = source_of.read(take)
                entry = {**source_of.entry(take), "largest_mm": packed.largest_mm}
                writer.add(
                    entry, packed.landmarks, packed.motion, packed.samples, scans=packed.scans
                )
            except DatasetError as error:
                writer.exclude(take.id, str(error))
        if not writer.sequences:
            raise LayoutError(f"{release.directory} has no usable take: {_first(writer.excluded)}")
        manifest = {"name": called, **source_of.manifest()}
        own = 0 if release.scans else len(source_of.speakers)  # a scan has no basis of faces
        coefficients = np.eye(len(source_of.speakers), own, dtype=np.float32)
        return writer.finish(manifest, coefficients, source_of.topologies())


class Source:
    """A release with all that was decided about it: speakers, unit, frame rates, splits.

    Args:
        release: what was found.
        fps: frames per second of the result; 0 keeps the release's.
        unit: length unit of the files, or ``auto``.

    Raises:
        DatasetError: no landmarks, or a frame rate that the release does not have.
    """

    def __init__(self, release: Release, fps: float = 0.0, unit: str = "auto") -> None:
        self.release = release
        self.marks = release.template.needed_landmarks()
        self._faults = {name: self._fault_of(name) for name in {t.speaker for t in release.takes}}
        self.speakers = sorted(name for name, fault in self._faults.items() if not fault)
        self._index = {name: index for index, name in enumerate(self.speakers)}
        if not self.speakers:
            raise MissingTemplateError(_first(self._faults))
        faces = [release.neutral[name] for name in self.speakers]
        self._origins = [self.marks.of(face).mean(axis=0) for face in faces]
        given = release.unit if unit == "auto" else unit
        self.pose: Pose = find_pose(faces, [self.marks.of(face) for face in faces], given)
        if release.flame is not None and not np.array_equal(self.pose.rotation, np.eye(3)):
            raise DatasetError(
                f"{release.flame.source} is no FLAME: its faces do not look along +z, +y up"
            )
        self.neutrals = [self.pose.apply(f - o) for f, o in zip(faces, self._origins, strict=True)]
        self.file_fps = self._measured_fps()
        self.step = max(1, round(self.file_fps / 30)) if self.file_fps >= _DECIMATED_FROM_FPS else 1
        if fps and not np.isclose(fps, self.file_fps / self.step):
            self.step = 1
        self.fps = fps or self.file_fps / self.step
        self.schemes = self._schemes()
        self._scanned = {
            name: scan_arrays(name, release.scans[name], marks, self.pose, origin)
            for name, marks, origin in zip(self.speakers, self.neutrals, self._origins, strict=True)
            if release.scans
        }

    @cached_property
    def fingerprint(self) -> str:
        """Changes with the options, faces, model, labels and splits, and with sizes and times of the files."""
        digest = hashlib.sha256(f"{self.fps} {self._facts()} {self.schemes}".encode())
        digest.update(np.stack(self.neutrals).tobytes())
        flame = self.release.flame
        if flame is not None:
            for array in flame.arrays(len(flame.expression_basis)).values():
                digest.update(array.tobytes())
        for take in self.release.takes:
            digest.update(json.dumps({**self.entry(take), "split": take.split}).encode())
            for path in (*take.paths, *take.scans):
                state = path.stat() if path.is_file() else None
                size = "" if state is None else f"{state.st_size} {state.st_mtime_ns}"
                digest.update(f" {size}\n".encode())
        return digest.hexdigest()[:16]

    def read(self, take: Take) -> PackedTake:
        """Sound, landmarks and motion of a take at one rate.

        Raises:
            DatasetError: what is wrong with it, by name.
        """
        if self._faults[take.speaker]:
            raise DatasetError(self._faults[take.speaker])
        if not any(self._splits_of(take)):
            raise LayoutError(
                "it belongs to no split of " + ", ".join(s.name for s in self.schemes)
            )
        values = take.motion()
        if len(values) == 0:
            raise DatasetError(f"{take.paths[0]} has no frames")
        finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
        if not finite.all():
            frame = int(np.flatnonzero(~finite)[0])
            raise NotFiniteError(f"{take.paths[0]}: frame {frame} holds NaN or infinity")
        sound = np.zeros(0, np.float32) if take.sound is None else take.sound()
        seconds, motion_s = len(sound) / SAMPLE_RATE_HZ, len(values) / self.file_fps
        if take.sound is not None and motion_s > seconds + SHORT_AUDIO_S:
            raise ShortAudioError(
                f"its sound lasts {seconds:.2f} s, its motion {motion_s:.2f} s ({len(values)} frames at "
                f"{self.file_fps:g} fps): the sound is cut short, or the frame rate is another"
            )
        heard = None if take.sound is None else max(1, int(seconds * self.fps + 0.5))
        landmarks, motion = self._packed(values, self._index[take.speaker], heard)
        samples = np.round(sound * FULL_SCALE).clip(-FULL_SCALE, FULL_SCALE - 1).astype(np.int16)
        scans = self._points(take, len(values))[: len(landmarks)] if take.scans else None
        return PackedTake(landmarks, motion, samples, scans)

    def entry(self, take: Take) -> dict[str, Any]:
        """What the manifest says of a take, beside where it lies."""
        return {
            "id": take.id,
            "split": self._splits_of(take),
            "source": self.release.kind,
            "take": take.id,
            "emotion": take.emotion,
            "intensity": take.intensity,
            "identity": self._index.get(take.speaker),
            "voice": take.speaker,
            "text": take.text,
        }

    def manifest(self) -> dict[str, Any]:
        """What the manifest says of the whole."""
        return {
            "fps": self.fps,
            "expressions": [],
            "moves": "own",
            "splits": {scheme.name: scheme.source for scheme in self.schemes},
            "facts": self._facts(),
            "identities": [
                {"name": name, "origin": origin.tolist()}
                for name, origin in zip(self.speakers, self._origins, strict=True)
            ],
            "topologies": [
                {
                    "name": name,
                    "file": f"topologies/{name}.npz",
                    "num_vertices": len(arrays["neutral"]),
                    "num_faces": len(arrays["faces"]),
                    **({"identity": self._index[name]} if self._scanned else {}),
                }
                for name, arrays in self.topologies().items()
            ],
        }

    def topologies(self) -> dict[str, dict[str, Array]]:
        """Arrays of the one meshing, or of each speaker's scan; none where the landmarks are all."""
        sparse = len(self.release.template.faces) == 0
        return self._scanned if sparse else {self.release.template.name: self._arrays}

    @cached_property
    def _arrays(self) -> dict[str, Array]:
        template = self.release.template
        masks = {"lip_mask": template.lip_mask, "upper_face_mask": template.upper_face_mask}
        count = template.num_vertices
        arrays: dict[str, Array] = {
            "neutral": np.zeros((count, 3), np.float32),
            "faces": template.faces.astype(np.int32),
            "identity_basis": np.stack(self.neutrals).astype(np.float32),
            "landmarks": self.marks.indices,
            **{k: np.zeros(count, bool) if m is None else m.flags(count) for k, m in masks.items()},
        }
        if self.release.flame is not None:
            arrays |= self.release.flame.arrays(next(self._readable()).shape[1] - 3)
        return arrays

    def _packed(
        self, values: Array, identity: int, frames: int | None
    ) -> tuple[FloatArray, FloatArray | None]:
        """Landmarks and motion of positions, or of FLAME's parameters: at most so many frames at the result's rate."""
        flame, neutral = self.release.flame, self.release.neutral[self.speakers[identity]]
        if flame is None:
            changed = np.asarray(values[:: self.step], np.float32) - neutral
            moved = self.pose.apply(self._at_rate(changed)[:frames])
            sparse = len(self.release.template.faces) == 0
            return self.marks.of(moved), None if sparse else moved
        factors = flame.factors(self._at_rate(values[:: self.step])[:frames])
        corners, marks = self._corners
        if factors.shape[1] != len(corners.expression_basis):
            known = len(corners.expression_basis) - 9
            raise VertexCountError(
                f"it has {values.shape[1] - 3} expressions, the first take {known}"
            )
        speaker = np.eye(len(self.speakers), dtype=np.float32)[identity]
        return marks.of(corners.displacements(factors, corners.neutral(speaker))), factors

    def _points(self, take: Take, frames: int) -> Array:
        """Points of a take's scans, (T, P, 3) m, at the result's rate."""
        if not np.isclose(self.file_fps / self.step, self.fps):
            raise LayoutError(
                f"its scans are of {self.file_fps:g} frames a second, which cannot be made {self.fps:g}: leave out fps"
            )
        paths = take.scans[:: self.step]
        origin = self._origins[self._index[take.speaker]]
        return sampled_scans(paths, len(range(0, frames, self.step)), self.pose, origin)

    @cached_property
    def _corners(self) -> tuple[Meshing, Landmarks]:
        """FLAME cut down to the landmarks' vertices and the jaw's joint, which is a vertex of its own there."""
        used, places = np.unique(self.marks.vertices, return_inverse=True)
        joint = self._arrays["jaw_regressor"]

        def cut(points: Array) -> Array:
            return np.concatenate(
                [points[:, used], np.tensordot(points, joint, (1, 0))[:, None]], axis=1
            )

        last = np.arange(len(used) + 1) == len(used)
        arrays = {
            "neutral": np.zeros((len(last), 3), np.float32),
            "faces": np.zeros((0, 3), np.int64),
            "identity_basis": cut(self._arrays["identity_basis"]),
            "expression_basis": cut(self._arrays["expression_basis"]),
            "lip_mask": last,
            "upper_face_mask": last,
            "jaw_weights": np.append(self._arrays["jaw_weights"][used], 0.0),
            "jaw_regressor": last.astype(np.float32),
        }
        marks = Landmarks(places.reshape(self.marks.vertices.shape), self.marks.weights, "")
        return Meshing(arrays), marks

    def _at_rate(self, values: Array) -> Array:
        given = self.file_fps / self.step
        if np.isclose(given, self.fps):
            return values
        return resample_frames(np.asarray(values, np.float32), given, self.fps)

    def _measured_fps(self) -> float:
        """Frame rate of the files, which do not state it: frames by the sound's length, rounded to a known rate."""
        rates, takes = self.release.rates, [t for t in self.release.takes if t.sound is not None]
        measured = []
        for take in takes[:: max(1, len(takes) // _PROBED)]:
            try:
                assert take.sound is not None
                measured.append(len(take.motion()) / max(len(take.sound()) / SAMPLE_RATE_HZ, 1e-6))
            except DatasetError:
                continue
        if not measured:
            return rates[0]
        found = float(np.median(measured))
        nearest = min(rates, key=lambda rate: abs(np.log(rate / max(found, 1e-6))))
        if abs(found / nearest - 1) > 0.10:
            raise LayoutError(
                f"{self.release.directory}: sound and motion give {found:.1f} frames a second; this dataset has "
                f"{', '.join(f'{rate:g}' for rate in rates)}. Most sounds are cut short, or belong to other motion"
            )
        return nearest

    def _readable(self) -> Iterator[Array]:
        for take in self.release.takes:
            try:
                yield take.motion()
            except DatasetError:
                continue

    def _schemes(self) -> list[SplitScheme]:
        """Split schemes that have something to train on come first."""
        release = self.release
        schemes = schemes_of(release.kind, self.speakers, release.directory)
        if any(take.split for take in release.takes):
            source = str(release.directory / "labels.csv")
            schemes.insert(0, SplitScheme("labels", source, schemes[0].speakers))
        trains = {
            scheme.name: any(
                scheme.of(t.speaker, t.sentence, t.variant) == "train" for t in release.takes
            )
            for scheme in schemes
        }
        return sorted(schemes, key=lambda scheme: not trains[scheme.name])

    def _splits_of(self, take: Take) -> list[str | None]:
        return [
            (take.split if scheme.name == "labels" else None)
            or scheme.of(take.speaker, take.sentence, take.variant)
            for scheme in self.schemes
        ]

    def _fault_of(self, speaker: str) -> str:
        """What is wrong with the neutral face of a speaker; empty where nothing is."""
        points, template = self.release.neutral.get(speaker), self.release.template
        if self.release.scans and speaker not in self.release.scans:
            return f"there is no neutral scan of {speaker}; there are those of {', '.join(self.release.scans)}"
        if points is None:
            known = ", ".join(sorted(self.release.neutral)) or "none"
            return f"there is no neutral face of {speaker}; there are those of {known}"
        if points.shape != (template.num_vertices, 3):
            return f"the template of {speaker} is {points.shape}, {template.name} has {template.num_vertices} vertices"
        return "" if np.isfinite(points).all() else f"the template of {speaker} holds NaN"

    def _facts(self) -> dict[str, Any]:
        return {
            "kind": self.release.kind,
            **self.release.template.describe(),
            **self.pose.describe(),
            "fps_of_files": self.file_fps,
            "decimated": self.step,
            **self.release.notes,
        }


def _first(reasons_by_name: dict[str, str]) -> str:
    counts = Counter(reasons_by_name.values())
    return "; ".join(f"{reason} ({count} x)" for reason, count in counts.most_common(3))
