"""Ground truth to score predictions against: a folder of motion, or a dataset that freetalk opens."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from freetalk._ffmpeg import AUDIO_SUFFIXES
from freetalk.audio import load_audio
from freetalk.data import NUM_LANDMARKS, DatasetError, LayoutError, Mask, open_dataset
from freetalk.data.templates import read_faces, speaker_of
from freetalk.evaluate.dataset_truth import DatasetTruth
from freetalk.evaluate.masks import Pairs, landmark_masks, landmark_pairs
from freetalk.evaluate.motion_files import (
    FloatArray,
    MotionFile,
    Origin,
    Phones,
    agreed,
    guess_kind,
    motion_paths,
    read_motion,
    read_stated,
    unit_scale,
)

_T = TypeVar("_T", bound="float | tuple[float, ...]")


class GroundTruth(Protocol):
    """Sequences that predictions are compared with; displacements from neutral in metres."""

    names: list[str]
    num_vertices: int
    fps: float | None
    up: tuple[float, float, float] | None
    masks: dict[str, Mask]
    lip_pairs: Pairs | None

    @property
    def has_neutral(self) -> bool:
        """Whether motion is known relative to the neutral face, not only relative to itself."""

    def motion(self, name: str) -> FloatArray:
        """(T, V, 3) m."""

    def place(self, file: MotionFile, name: str, kind: str, scale: float | None) -> FloatArray:
        """A prediction as displacements in the frame of :meth:`motion`.

        Args:
            file: what was read.
            name: its sequence.
            kind: ``vertices``, ``displacements``, or ``auto``.
            scale: metres per unit of a file that does not say it; ``None``: as the ground truth's.

        Raises:
            ValueError: its unit is not known, or its frame rate, axes or kind are not the ground truth's.
        """

    def origin(self, name: str) -> Origin:
        """Who speaks, and in which take: what sequences have in common."""

    def phones(self, name: str) -> Phones:
        """(start in s, end in s, ARPABET label); empty where none are known."""

    def audio(self, name: str) -> tuple[FloatArray, float] | None:
        """Samples and their rate in Hz."""

    def emotion(self, name: str) -> str | None:
        """The label."""

    def describe(self) -> dict[str, Any]:
        """What results say of it."""


@dataclass(frozen=True)
class FolderSettings:
    """What a folder of motion does not say itself; what its files say must not differ from it.

    Attributes:
        unit: m, cm, mm, in, or metres per unit; ``None``: as each file says.
        kind: ``vertices``, ``displacements``, or ``auto``: as each file says, else by comparison with
            the neutral face, else by size.
        templates: neutral faces by speaker, in ``unit``.
        fps: frames per second; ``None``: as the files say.
        wav: folder of recordings, named as the motion.
        phones: JSON, sequence to a list of (start in s, end in s, ARPABET label).
        emotions: JSON, sequence to label.
    """

    unit: str | None = None
    kind: str = "auto"
    templates: Path | None = None
    fps: float | None = None
    wav: Path | None = None
    phones: Path | None = None
    emotions: Path | None = None


def open_ground_truth(
    path: Path,
    settings: FolderSettings,
    split: str | None = None,
    topology: str | None = None,
    scheme: str = "",
) -> GroundTruth:
    """A folder of ``.npy`` or ``.npz``, or whatever ``freetalk.data.open_dataset`` understands.

    Args:
        path: the folder.
        settings: of a folder of motion; a dataset knows its own.
        split: of a dataset; ``test`` by default.
        topology: of a dataset with several meshings; ``landmarks`` for the 68 points.
        scheme: name of a dataset's split scheme; empty for its first.

    Raises:
        ValueError, OSError: what is missing or wrong.
    """
    try:
        return DatasetTruth(open_dataset(path, split=scheme), split or "test", topology)
    except LayoutError:
        if not motion_paths(path):
            raise
    if split or topology:
        raise ValueError(f"{path} is a folder of motion: it has no splits and no topologies")
    return FolderTruth(path, settings)


class FolderTruth:
    """A folder with one ``.npy`` or ``.npz`` a sequence, named after it."""

    def __init__(self, directory: Path, settings: FolderSettings) -> None:
        self.directory, self.settings = directory, settings
        self._paths = {path.stem: path for path in motion_paths(directory)}
        self.names = list(self._paths)
        self._unit = None if settings.unit is None else unit_scale(settings.unit)
        self._templates = {} if settings.templates is None else read_faces(settings.templates)[0]
        stated = {path: read_stated(path) for path in self._paths.values()}
        own_fps = _common({path: own.fps for path, own in stated.items()}, "fps")
        self.fps = agreed(own_fps, settings.fps, f"{directory}: frames per second", "--fps")
        self.up: tuple[float, float, float] | None = _common(
            {path: own.up for path, own in stated.items()}, "axis to the top of the head"
        )
        self.masks: dict[str, Mask] = {}
        self.lip_pairs: Pairs | None = None
        first = read_motion(self._paths[self.names[0]])
        self.num_vertices = first.frames.shape[1]
        if self.num_vertices == NUM_LANDMARKS:
            self.masks, self.lip_pairs = landmark_masks(), landmark_pairs()
        for speaker, points in self._templates.items():
            if points.shape != (self.num_vertices, 3):
                raise DatasetError(
                    f"{settings.templates}: the neutral face {speaker} has {len(points)} vertices, "
                    f"{first.path} has {self.num_vertices}"
                )
        self._scale = first.scale(self._unit, "--unit")
        self.kind = self._kind_of(first, self.names[0], settings.kind, self._scale)
        self._phones = _read_json(settings.phones)
        self._emotions = _read_json(settings.emotions)
        found = [] if settings.wav is None else sorted(settings.wav.iterdir())
        self._sounds = {p.stem: p for p in found if p.suffix.lower() in AUDIO_SUFFIXES}

    @property
    def has_neutral(self) -> bool:
        """Whether motion is known relative to the neutral face."""
        return self.kind == "displacements" or bool(self._templates)

    def motion(self, name: str) -> FloatArray:
        """(T, V, 3) m, relative to the neutral face where that is known."""
        file = read_motion(self._paths[name], self.num_vertices)
        scale = file.scale(self._unit, "--unit")
        return self._placed(file, name, self.settings.kind, scale)

    def place(self, file: MotionFile, name: str, kind: str, scale: float | None) -> FloatArray:
        """A prediction in the frame of :meth:`motion`."""
        file.check_fits(self.fps, self.up)
        given = self._unit if scale is None else scale
        if scale is None and file.stated.metres_per_unit is not None:
            given = None  # --unit is of the ground truth: a prediction's own word goes before it
        return self._placed(file, name, kind, file.scale(given, "--pred-unit"))

    def origin(self, name: str) -> Origin:
        """The speaker, where templates name them; each sequence is a take."""
        return Origin(speaker_of(name, self._templates) or "", name)

    def phones(self, name: str) -> Phones:
        """Phones of a sequence."""
        return [(float(a), float(b), str(label)) for a, b, label in self._phones.get(name, [])]

    def audio(self, name: str) -> tuple[FloatArray, float] | None:
        """Samples and rate of the recording of that name."""
        if name not in self._sounds:
            return None
        sound = load_audio(self._sounds[name])
        return np.asarray(sound.samples, dtype=np.float32), float(sound.sample_rate_hz)

    def emotion(self, name: str) -> str | None:
        """The label of a sequence."""
        label = self._emotions.get(name)
        return None if label is None else str(label)

    def describe(self) -> dict[str, Any]:
        """Folder, unit, kind, templates."""
        return {
            "source": str(self.directory),
            "layout": "folder of motion",
            "kind": self.kind,
            "metres_per_unit": self._scale,
            "fps": self.fps,
            "vertices": self.num_vertices,
            "templates": None if self.settings.templates is None else str(self.settings.templates),
        }

    def _neutral(self, name: str) -> FloatArray | None:
        """(V, 3) m of the speaker, ``None`` where no templates are given."""
        if not self._templates:
            return None
        speaker = speaker_of(name, self._templates)
        if speaker is None:
            known = ", ".join(sorted(self._templates)[:5])
            raise DatasetError(
                f"sequence {name} begins with none of the templates' names ({known} …)"
            )
        return self._templates[speaker] * np.float32(self._unit or self._scale)

    def _kind_of(self, file: MotionFile, name: str, kind: str, scale: float) -> str:
        if kind != "auto":
            return kind
        if file.is_displacement is not None:
            return "displacements" if file.is_displacement else "vertices"
        return guess_kind(file.frames[0], self._neutral(name), scale, name)

    def _placed(self, file: MotionFile, name: str, kind: str, scale: float) -> FloatArray:
        kind = self._kind_of(file, name, kind, scale)
        if kind != self.kind and not self._templates:
            raise ValueError(
                f"{file.path} holds {kind}, the ground truth {self.kind}; give --templates to compare them"
            )
        metres = file.frames * np.float32(scale)
        neutral = self._neutral(name) if kind == "vertices" else None
        return metres if neutral is None else metres - neutral


def _common(stated: dict[Path, _T | None], what: str) -> _T | None:
    """What all files that say it say alike.

    Raises:
        ValueError: two files differ.
    """
    found = [(path, value) for path, value in stated.items() if value is not None]
    for path, value in found:
        if not np.allclose(np.asarray(value), np.asarray(found[0][1]), rtol=1e-6, atol=1e-9):
            raise ValueError(
                f"{path} has another {what}, {value}, than {found[0][0]}, {found[0][1]}"
            )
    return found[0][1] if found else None


def _read_json(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    content = json.loads(path.read_text())
    if not isinstance(content, dict):
        raise DatasetError(f"{path} holds no mapping from sequences")
    return content
