"""Recordings of faces in one meshing, whatever their layout: unified at the door, read as needed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from freetalk import geometry
from freetalk._files import content_hash
from freetalk.audio import load_audio
from freetalk.data.dataset import EMOTIONS, FaceMesh, FloatArray, MotionSequence, chosen
from freetalk.data.errors import (
    DatasetError,
    Findings,
    LayoutError,
    MissingFileError,
    MissingTemplateError,
    NotFiniteError,
    ShortAudioError,
    VertexCountError,
)
from freetalk.data.frames import FrameSource
from freetalk.data.landmark_cache import LandmarkCache
from freetalk.data.pose import Pose, find_pose
from freetalk.data.splits import SplitScheme
from freetalk.data.templates import Template

SAMPLE_RATE_HZ = 16000
#: Motion that outlasts its sound by less is cut (recorders stop a little apart); more is an error.
SHORT_AUDIO_S = 0.25


@dataclass(frozen=True)
class Recording:
    """One take as it lies on disk.

    Attributes:
        id: unique name.
        speaker: whose face and voice it is.
        sentence: number of the sentence, where splits need it.
        audio: sound file; ``None`` where the take has none.
        frames: its motion.
        emotion: our name of the emotion.
        intensity: 1 to 3.
        text: transcript.
        split: split that the data itself names; the scheme decides where it names none.
    """

    id: str
    speaker: str
    sentence: int | None
    audio: Path | None
    frames: FrameSource
    emotion: str = "neutral"
    intensity: float = 1.0
    text: str | None = None
    split: str | None = None


@dataclass(frozen=True)
class RegisteredParts:
    """What an adapter found.

    Attributes:
        kind: layout, such as ``vocaset``.
        recordings: takes in any order.
        neutral: neutral face (V, 3) of each speaker, the file's unit.
        template: the meshing.
        fps: frames per second after decimation.
        file_fps: frames per second of the files.
        scheme: who belongs to which split.
        unit: length unit, or ``auto``.
        notes: what results should say of the source.
        sources: files that make frames of what the motion files hold, such as a model's bases.
    """

    kind: str
    recordings: list[Recording]
    neutral: dict[str, FloatArray]
    template: Template
    fps: float
    file_fps: float
    scheme: SplitScheme
    unit: str = "auto"
    notes: dict[str, Any] = field(default_factory=dict)
    sources: tuple[Path, ...] = ()


class RegisteredDataset:
    """A dataset of registered meshes: a sequence moves the face it was recorded on, and no other.

    Args:
        name: of the dataset.
        directory: its folder.
        parts: what the adapter found there.
        findings: collects what is wrong instead of raising it.

    Raises:
        DatasetError: what is wrong, by name.
    """

    sample_rate_hz = SAMPLE_RATE_HZ
    emotions = EMOTIONS

    def __init__(
        self, name: str, directory: Path, parts: RegisteredParts, findings: Findings | None = None
    ) -> None:
        self.name, self.directory, self.kind = name, directory, parts.kind
        self.fps, self.file_fps = float(parts.fps), float(parts.file_fps)
        self.template, self.scheme, self.notes = parts.template, parts.scheme, parts.notes
        self.topology, self.sources = parts.template.name, parts.sources
        self.left_out = 0
        self._neutral: dict[str, FloatArray] = {}
        self._identity: dict[str, int] = {}
        self._recordings: dict[str, Recording] = {}
        self._sequences: list[MotionSequence] = []
        findings = findings or Findings()
        self._keep_neutral(parts, findings)
        self._keep_sequences(parts, findings)
        if not self._sequences:
            findings.add(LayoutError(f"{directory} has no usable sequence of {parts.kind}"))
        self.pose = self._find_pose(parts.unit)
        self._order = {s.id: index for index, s in enumerate(self._sequences)}
        self._cache: LandmarkCache | None = None

    @cached_property
    def fingerprint(self) -> str:
        """Changes with the neutral faces, the template's lists, the model that poses faces, the unit, and
        the lengths, sizes and times of the motion files, which are too many to read."""
        digest = hashlib.sha256(f"2 {self.describe()}".encode())
        for speaker, points in self._neutral.items():
            digest.update(f"{speaker} ".encode() + points.tobytes())
        for path in self.sources:
            digest.update(content_hash(path).encode())
        changed: dict[Path, str] = {}
        for sequence in self._sequences:
            path = self._recordings[sequence.id].frames.path
            if path not in changed:
                state = path.stat()
                changed[path] = f"{state.st_size} {state.st_mtime_ns}"
            digest.update(f"{sequence.id} {sequence.num_frames} {changed[path]}".encode())
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
        stop = sequence.num_frames if stop is None else min(stop, sequence.num_frames)
        points = self.template.needed_landmarks()
        neutral = points.of(self._neutral[self._recordings[sequence.id].speaker])

        def compute() -> FloatArray:
            moved = [
                points.of(self._positions(sequence, first, min(first + 64, sequence.num_frames)))
                for first in range(0, sequence.num_frames, 64)
            ]
            return self.pose.apply(np.concatenate(moved) - neutral)

        if self._cache is None:
            total = sum(s.num_frames for s in self._sequences)
            folder = geometry.default_cache_dir() / "datasets" / f"landmarks-{self.fingerprint}"
            self._cache = LandmarkCache(folder, total, len(self._sequences))
        rows = self._cache.get(
            self._order[sequence.id], sequence.start_frame, sequence.num_frames, compute
        )
        return np.array(rows[start:stop])

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """Samples of the sequence at ``sample_rate_hz``, (S,) float32 in [-1, 1]."""
        if sequence.audio is None:
            samples = round(sequence.num_frames / sequence.fps * SAMPLE_RATE_HZ)
            return np.zeros(samples, dtype=np.float32)
        sound = load_audio(sequence.audio, SAMPLE_RATE_HZ)
        return np.asarray(sound.samples, dtype=np.float32)

    def identities(self, split: str | None = None) -> list[int]:
        """Indices of the speakers of a split."""
        return sorted({s.identity for s in self.sequences(split)})

    def topologies(self, split: str | None = None) -> list[str]:
        """The one meshing."""
        return [self.topology] if self.sequences(split) and len(self.template.faces) else []

    def num_vertices(self, topology: str) -> int:
        """Vertices V of the meshing."""
        self._check_topology(topology)
        return self.template.num_vertices

    def faces(self, split: str | None = None, max_vertices: int = 0) -> list[tuple[int, str]]:
        """(identity, topology) of the speakers of a split."""
        if 0 < max_vertices < self.template.num_vertices:
            return []
        return [(i, t) for t in self.topologies(split) for i in self.identities(split)]

    def mesh(self, identity: int, topology: str) -> FaceMesh:
        """Neutral face of a speaker in the canonical frame, its landmarks' mean at the origin."""
        self._check_topology(topology)
        speaker = list(self._identity)[identity]
        neutral = self._neutral[speaker]
        origin = neutral.mean(axis=0)
        if self.template.landmarks is not None:
            origin = self.template.landmarks.of(neutral).mean(axis=0)
        count, lips, upper = self.template.num_vertices, *self._masks()
        return FaceMesh(
            name=f"{self.name}/{speaker}/{topology}",
            vertices=self.pose.apply(neutral - origin),
            faces=self.template.faces,
            lip_mask=np.zeros(count, bool) if lips is None else lips.flags(count),
            upper_face_mask=np.zeros(count, bool) if upper is None else upper.flags(count),
            dataset=self.name,
        )

    def vertex_displacements(
        self, topology: str, sequence: MotionSequence, start: int = 0, stop: int | None = None
    ) -> FloatArray:
        """Vertex displacements of frames [start, stop), (T, V, 3) float32, m."""
        self._check_topology(topology)
        stop = sequence.num_frames if stop is None else min(stop, sequence.num_frames)
        neutral = self._neutral[self._recordings[sequence.id].speaker]
        return self.pose.apply(self._positions(sequence, start, stop) - neutral)

    def neutral(self, sequence: MotionSequence) -> FloatArray:
        """Neutral face of a sequence's speaker, (V, 3), the file's unit and axes."""
        return self._neutral[self._recordings[sequence.id].speaker]

    def speaker(self, sequence: MotionSequence) -> str:
        """Name of the speaker of a sequence, as the dataset has it."""
        return self._recordings[sequence.id].speaker

    def describe(self) -> dict[str, Any]:
        """What results say of the data: template, masks, unit, frame rate, split."""
        return {
            "name": self.name,
            "kind": self.kind,
            **self.template.describe(),
            **self.pose.describe(),
            "fps": self.fps,
            "fps_of_files": self.file_fps,
            "split": {"name": self.scheme.name, "source": self.scheme.source},
            "sequences": {split: len(self.sequences(split)) for split in ("train", "val", "test")},
            "sequences_in_no_split": self.left_out,
            **self.notes,
        }

    def check(self) -> None:
        """Everything that can be told without reading the motion was told when it was opened."""
        self.template.needed_landmarks()

    def _masks(self) -> tuple[Any, Any]:
        return self.template.lip_mask, self.template.upper_face_mask

    def _check_topology(self, topology: str) -> None:
        if topology != self.topology:
            raise ValueError(f"no topology {topology!r} in {self.name}; known: ['{self.topology}']")

    def _positions(self, sequence: MotionSequence, start: int, stop: int) -> FloatArray:
        """Frames [start, stop) in the file's unit, all finite."""
        frames = self._recordings[sequence.id].frames
        positions = frames.read(start, stop)
        finite = np.isfinite(positions).all(axis=(1, 2))
        if not finite.all():
            frame = start + int(np.flatnonzero(~finite)[0])
            raise NotFiniteError(
                f"{frames.path}: sequence {sequence.id}, frame {frame} (at {sequence.fps:g} fps) holds "
                "NaN or infinity; mend it or take the sequence out of the folder"
            )
        return positions

    def _find_pose(self, unit: str) -> Pose:
        templates = list(self._neutral.values())
        points = self.template.landmarks
        landmarks = [] if points is None else [points.of(t) for t in templates]
        return find_pose(templates or [np.zeros((1, 3), np.float32)], landmarks, unit)

    def _keep_neutral(self, parts: RegisteredParts, findings: Findings) -> None:
        wanted = {r.speaker for r in parts.recordings}
        for speaker in sorted(wanted):
            points = parts.neutral.get(speaker)
            if points is None:
                known = ", ".join(sorted(parts.neutral)) or "none"
                findings.add(
                    MissingTemplateError(
                        f"{self.directory} has motion of {speaker}, but no neutral face; there are "
                        f"templates of: {known}"
                    )
                )
            elif points.shape != (self.template.num_vertices, 3):
                findings.add(
                    VertexCountError(
                        f"{self.directory}: the template of {speaker} is {points.shape}, "
                        f"{self.template.name} has {self.template.num_vertices} vertices"
                    )
                )
            elif not np.isfinite(points).all():
                findings.add(
                    NotFiniteError(f"{self.directory}: the template of {speaker} holds NaN")
                )
            else:
                self._identity[speaker] = len(self._identity)
                self._neutral[speaker] = points.astype(np.float32)

    def _keep_sequences(self, parts: RegisteredParts, findings: Findings) -> None:
        first = 0
        for recording in sorted(parts.recordings, key=lambda r: r.id):
            split = recording.split or parts.scheme.of(recording.speaker, recording.sentence)
            if recording.speaker not in self._identity:
                continue  # its template is among the findings
            if split is None:
                self.left_out += 1
                continue
            try:
                frames = self._usable_frames(recording)
            except DatasetError as error:
                findings.add(error)
                continue
            self._recordings[recording.id] = recording
            self._sequences.append(
                MotionSequence(
                    id=recording.id,
                    split=split,
                    source=parts.kind,
                    take=recording.id,
                    audio=recording.audio,
                    start_frame=first,
                    num_frames=frames,
                    emotion=EMOTIONS.index(recording.emotion),
                    intensity=recording.intensity,
                    identity=self._identity[recording.speaker],
                    voice=recording.speaker,
                    text=recording.text,
                    fps=self.fps,
                    topology=self.topology,
                    dataset=self.name,
                )
            )
            first += frames

    def _usable_frames(self, recording: Recording) -> int:
        """Frames that have sound.

        Raises:
            MissingFileError, ShortAudioError, DatasetError: no sound, too little, or unreadable.
        """
        frames = recording.frames
        if frames.num_points != self.template.num_vertices:
            raise VertexCountError(
                f"{frames.path} has {frames.num_points} points a frame, {self.template.name} has "
                f"{self.template.num_vertices}"
            )
        if frames.num_frames == 0:
            raise DatasetError(f"{frames.path}: sequence {recording.id} has no frames")
        if recording.audio is None:
            return frames.num_frames
        if not recording.audio.is_file():
            raise MissingFileError(
                f"sequence {recording.id} has no sound: {recording.audio} is missing"
            )
        seconds, motion_s = audio_duration_s(recording.audio), frames.num_frames / self.fps
        if motion_s > seconds + SHORT_AUDIO_S:
            raise ShortAudioError(
                f"{recording.audio} lasts {seconds:.2f} s, its motion {motion_s:.2f} s "
                f"({frames.num_frames} frames at {self.fps:g} fps); the file is cut short, or the frame "
                "rate of the motion is another"
            )
        return min(frames.num_frames, max(1, int(seconds * self.fps + 0.5)))


def audio_duration_s(path: Path) -> float:
    """Length of a sound file.

    Raises:
        DatasetError: it is none.
    """
    try:
        info = soundfile.info(str(path))
    except (RuntimeError, OSError) as error:
        raise DatasetError(f"{path} is no readable sound file: {error}") from error
    return float(info.frames) / float(info.samplerate)
