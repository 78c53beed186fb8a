"""What the layouts of public datasets share: pairs of sound and motion, templates, frame rates."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.dataset import FloatArray
from freetalk.data.errors import (
    DatasetError,
    Findings,
    LayoutError,
    MissingFileError,
    MissingTemplateError,
)
from freetalk.data.frames import NpyFrames
from freetalk.data.registered import Recording, RegisteredParts, audio_duration_s
from freetalk.data.safe_pickle import load_pickle
from freetalk.data.splits import scheme_of
from freetalk.data.templates import find_template, find_template_mesh, read_mesh

#: Frame rates from this one on are decimated towards 30.
_DECIMATED_FROM_FPS = 50.0
_PROBED = 32
_MOTION_FOLDERS = ("vertices_npy", "vertices", "sequences", "motion")
_MESH_SUFFIXES = (".obj", ".ply", ".off", ".stl")


@dataclass(frozen=True)
class Request:
    """What is asked of an adapter.

    Attributes:
        directory: the dataset's folder.
        split: name of the split scheme, empty for the default.
        unit: length unit of the files, or ``auto``.
        findings: raises, or collects what is wrong.
    """

    directory: Path
    split: str = ""
    unit: str = "auto"
    findings: Findings = dataclasses.field(default_factory=Findings)


@dataclass(frozen=True)
class FileName:
    """What the name of a sequence's file says."""

    speaker: str
    sentence: int | None = None
    emotion: str = "neutral"
    intensity: float = 1.0


def motion_folder(directory: Path) -> Path | None:
    """The folder that holds a ``.npy`` a sequence."""
    for name in _MOTION_FOLDERS:
        if (directory / name).is_dir():
            return directory / name
    return None


def paired_recordings(
    request: Request,
    num_points: int,
    parse: Callable[[str], FileName | None],
    with_sound: bool = True,
) -> list[Recording]:
    """One recording for each ``.npy`` of the motion folder, with the ``.wav`` of its name.

    Args:
        request: where.
        num_points: points of a frame; 0 takes the files'.
        parse: what a file's name says; ``None`` leaves the file out.
        with_sound: whether there is any sound.
    """
    motion = motion_folder(request.directory)
    if motion is None:
        raise LayoutError(
            f"{request.directory} has none of the folders {', '.join(_MOTION_FOLDERS)}"
        )
    recordings = []
    for path in sorted(motion.glob("*.npy")):
        try:
            named = parse(path.stem)
            if named is None:
                continue
            recordings.append(
                Recording(
                    id=path.stem,
                    speaker=named.speaker,
                    sentence=named.sentence,
                    audio=request.directory / "wav" / f"{path.stem}.wav" if with_sound else None,
                    frames=NpyFrames(path, num_points),
                    emotion=named.emotion,
                    intensity=named.intensity,
                )
            )
        except DatasetError as error:
            request.findings.add(error)
    if not recordings:
        request.findings.add(LayoutError(f"{motion} holds no motion (.npy) of this dataset"))
    return recordings


def read_neutral(
    directory: Path, elsewhere: Iterable[Path] = ()
) -> tuple[dict[str, FloatArray], dict[str, npt.NDArray[np.int64]]]:
    """Neutral faces by speaker, and the triangles of those that are mesh files.

    They are ``templates.pkl`` (a mapping to (V, 3) arrays) or one mesh or ``.npy`` a speaker in
    ``templates``.

    Args:
        directory: the dataset's folder.
        elsewhere: more places to look for either.

    Raises:
        MissingTemplateError: neither is there.
        UnsafePickleError, DatasetError: a file is not what it should be.
    """
    for place in (directory, *elsewhere):
        if (place / "templates.pkl").is_file():
            return _pickled_templates(place / "templates.pkl"), {}
        folder = place / "templates"
        files = sorted(folder.iterdir()) if folder.is_dir() else []
        meshes = {f.stem: f for f in files if f.suffix.lower() in (*_MESH_SUFFIXES, ".npy")}
        if meshes:
            return _mesh_templates(meshes)
    raise MissingTemplateError(
        f"{directory} has no neutral faces: neither templates.pkl nor templates/SPEAKER.ply"
    )


def _pickled_templates(path: Path) -> dict[str, FloatArray]:
    content = load_pickle(path)
    if not isinstance(content, dict):
        raise DatasetError(
            f"{path} holds {type(content).__name__}; expected speakers and their faces"
        )
    neutral = {}
    for speaker, points in content.items():
        array = np.asarray(points)
        if array.dtype.kind != "f" or array.size % 3:
            raise DatasetError(f"{path}: the template of {speaker} is {array.dtype} {array.shape}")
        neutral[str(speaker)] = array.reshape(-1, 3).astype(np.float32)
    return neutral


def _mesh_templates(
    files: dict[str, Path],
) -> tuple[dict[str, FloatArray], dict[str, npt.NDArray[np.int64]]]:
    neutral, faces = {}, {}
    for speaker, path in files.items():
        if path.suffix == ".npy":
            neutral[speaker] = _neutral_array(path)
        else:
            neutral[speaker], faces[speaker] = read_mesh(path)
    return neutral, faces


def _neutral_array(path: Path) -> FloatArray:
    """A single frame (V, 3) from a ``.npy``."""
    array = np.load(path, allow_pickle=False)
    if array.dtype.kind != "f" or array.ndim != 2 or array.shape[1] != 3:
        raise DatasetError(f"{path} is {array.dtype} {array.shape}; a neutral face is (V, 3)")
    return np.asarray(array, dtype=np.float32)


def common_size(neutral: dict[str, FloatArray]) -> int:
    """Vertices of most neutral faces, so that one bad template does not decide."""
    sizes = [len(points) for points in neutral.values()]
    return max(set(sizes), key=sizes.count)


def find_faces(
    directory: Path,
    neutral: dict[str, FloatArray],
    faces: dict[str, npt.NDArray[np.int64]],
    template: str = "flame",
) -> npt.NDArray[np.int64]:
    """Triangles of the meshing: those of the speakers' meshes, or of the template's mesh file.

    Raises:
        MissingFileError: no file tells the triangles; says which to bring.
    """
    if faces:
        return next(iter(faces.values()))
    path = find_template_mesh(directory, template)
    if path is None:
        raise MissingFileError(
            f"{directory} names no triangles: put the template's mesh (FLAME_sample.ply of the VOCA "
            "repository, or template.ply) there"
        )
    vertices, triangles = read_mesh(path)
    counts = {len(points) for points in neutral.values()}
    if counts and len(vertices) not in counts:
        raise DatasetError(
            f"{path} has {len(vertices)} vertices, the neutral faces {sorted(counts)}"
        )
    return triangles


def file_fps(recordings: list[Recording], candidates: tuple[float, ...], directory: Path) -> float:
    """Frame rate of motion files, which do not state it: frames by the sound's length, rounded.

    Args:
        recordings: with every frame of their files.
        candidates: rates that copies of this dataset are known to have, the published one first.
        directory: for messages.

    Raises:
        LayoutError: no candidate is within 10 %.
    """
    step = max(1, len(recordings) // _PROBED)
    rates = []
    for recording in recordings[::step]:
        if recording.audio is not None and recording.audio.is_file():
            seconds = audio_duration_s(recording.audio)
            rates.append(recording.frames.num_frames / max(seconds, 1e-6))
    if not rates:
        return candidates[0]
    measured = float(np.median(rates))
    nearest = min(candidates, key=lambda rate: abs(np.log(rate / max(measured, 1e-6))))
    if abs(measured / nearest - 1) > 0.10:
        listed = ", ".join(f"{rate:g}" for rate in candidates)
        raise LayoutError(
            f"{directory}: sound and motion give {measured:.1f} frames a second; this dataset has "
            f"{listed}. Most wavs are cut short, or belong to other motion"
        )
    return nearest


def registered_parts(
    request: Request,
    kind: str,
    recordings: list[Recording],
    neutral: dict[str, FloatArray],
    faces: npt.NDArray[np.int64],
    candidates: tuple[float, ...],
    notes: dict[str, Any] | None = None,
    sources: tuple[Path, ...] = (),
) -> RegisteredParts:
    """Unifies the frame rate, recognises the template and finds the split."""
    num_vertices = common_size(neutral)
    given = file_fps(recordings, candidates, request.directory)
    step = max(1, round(given / 30)) if given >= _DECIMATED_FROM_FPS else 1
    if step > 1:
        recordings = [dataclasses.replace(r, frames=r.frames.decimated(step)) for r in recordings]
    template = find_template(request.directory, faces, num_vertices, kind)
    speakers = [r.speaker for r in recordings]
    return RegisteredParts(
        kind=kind,
        recordings=recordings,
        neutral=neutral,
        template=template,
        fps=given / step,
        file_fps=given,
        scheme=scheme_of(kind, request.split, speakers, request.directory),
        unit=request.unit,
        notes={"decimated": step, **(notes or {})},
        sources=sources,
    )


def folder_settings(directory: Path) -> dict[str, Any]:
    """``dataset.json`` of a folder: kind, fps, unit, split; empty without the file.

    Raises:
        DatasetError: no mapping, or an unknown key.
    """
    path = directory / "dataset.json"
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON: {error}") from error
    known = {"kind", "fps", "unit", "split", "name"}
    if not isinstance(content, dict) or not set(content) <= known:
        raise DatasetError(f"{path} must map some of {', '.join(sorted(known))}")
    return content
