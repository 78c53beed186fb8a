"""MEAD-EMOTE: FLAME reconstructions of MEAD (Wang et al. 2020) that EMOTE (Danecek et al. 2023) releases.

As EMOTE's code writes them, 25 fps: ``reconstructions/METHOD/ACTOR/front/EMOTION/level_N/NNN/shape_pose_cam.hdf5``
with ``shape`` (1, T, 300), ``exp`` (1, T, 100) and ``jaw`` (1, T, 3), and ``audio/ACTOR/front/EMOTION/level_N/
NNN.wav``; ``processed`` may lie between. An actor's neutral face has the mean shape of the first of the
actor's takes; head pose and camera are left out. Vertices in pairs of ``vertices/ACTOR_EMOTION_level_N_NNN.npy``
and ``wav`` with ``templates`` are read too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from freetalk.data.dataset import FloatArray
from freetalk.data.emotions import LABELS, emotion_of, intensity_of
from freetalk.data.errors import DatasetError, LayoutError, VertexCountError
from freetalk.data.flame import Flame, find_flame
from freetalk.data.layouts import (
    FileName,
    Request,
    common_size,
    find_faces,
    paired_recordings,
    read_neutral,
    registered_parts,
)
from freetalk.data.registered import Recording, RegisteredParts

_FILE = "shape_pose_cam.hdf5"
_EMOTIONS = "|".join(LABELS["mead"])
_NAME = re.compile(
    rf"(?P<speaker>[MW]\d+)_(?:front_)?(?P<emotion>{_EMOTIONS})_(?:level_)?(?P<level>\d)_(?P<take>\d+)\Z"
)
_FPS = 25.0


class FlameFrames:
    """Frames of FLAME's parameters in one ``.hdf5``, turned into vertices as they are read.

    Args:
        path: the file.
        flame: the model.
        step: keep every ``step``-th frame.

    Raises:
        VertexCountError, DatasetError: arrays of another shape; not readable.
    """

    def __init__(self, path: Path, flame: Flame, step: int = 1) -> None:
        self.path, self.flame, self.step = path, flame, step
        self.num_points = len(flame.template)
        self.neutral: FloatArray = flame.template
        expression, jaw = _shapes(path, ("exp", "jaw"))
        if expression[0] != jaw[0] or jaw[1] != 3:
            raise VertexCountError(f"{path}: exp is {expression}, jaw is {jaw} (frames, numbers)")
        self._file_frames = expression[0]
        self.num_frames = -(-self._file_frames // step)

    def decimated(self, step: int) -> FlameFrames:
        """The same file, every ``step``-th frame."""
        changed = FlameFrames(self.path, self.flame, step)
        changed.neutral = self.neutral
        return changed

    def read(self, start: int, stop: int) -> FloatArray:
        """Vertices of frames [start, stop), (T, V, 3) float32, m."""
        import h5py

        rows = slice(start * self.step, stop * self.step, self.step)
        with h5py.File(self.path, "r") as file:
            expression, jaw = file["exp"][0, rows], file["jaw"][0, rows]
        return self.flame.posed(self.neutral, expression, jaw)


def is_emote(directory: Path) -> bool:
    """Whether a folder has the layout of EMOTE's processed MEAD."""
    return _processed(directory) is not None


def read_emote(request: Request) -> RegisteredParts:
    """EMOTE's reconstructions.

    Raises:
        DatasetError: what is missing or wrong, by name.
    """
    root = _processed(request.directory)
    if root is None:
        raise LayoutError(f"{request.directory} has no reconstructions")
    flame = find_flame(request.directory)
    recordings: list[Recording] = []
    sources: dict[str, FlameFrames] = {}
    for path, parts in _takes(root):
        speaker, label, level, take = parts
        try:
            frames = FlameFrames(path, flame)
            emotion = emotion_of(label, "mead", str(path))
            intensity = intensity_of(level.removeprefix("level_"), str(path))
        except DatasetError as error:
            request.findings.add(error)
            continue
        sources.setdefault(speaker, frames)
        recordings.append(
            Recording(
                id=f"{speaker}_{label}_{level}_{take}",
                speaker=speaker,
                sentence=None,
                audio=root / "audio" / speaker / "front" / label / level / f"{take}.wav",
                frames=frames,
                emotion=emotion,
                intensity=intensity,
            )
        )
    neutral = {speaker: _neutral(frames, flame) for speaker, frames in sources.items()}
    for recording in recordings:
        recording.frames.neutral = neutral[recording.speaker]  # type: ignore[attr-defined]
    if not recordings:
        raise LayoutError(f"{root}/reconstructions holds no .../front/EMOTION/level_N/NNN/{_FILE}")
    notes = {"layout": "EMOTE", "flame": flame.source}
    return registered_parts(
        request, "mead", recordings, neutral, flame.faces, (_FPS,), notes, (Path(flame.source),)
    )


def read_mead(request: Request) -> RegisteredParts:
    """Pairs of vertices and sound.

    Raises:
        DatasetError: what is missing or wrong, by name.
    """
    neutral, faces = read_neutral(request.directory)
    triangles = find_faces(request.directory, neutral, faces)

    def parse(stem: str) -> FileName | None:
        match = _NAME.match(stem)
        if match is None:
            return None
        emotion = emotion_of(match["emotion"], "mead", stem)
        return FileName(match["speaker"], None, emotion, intensity_of(match["level"], stem))

    recordings = paired_recordings(request, common_size(neutral), parse)
    rates = (_FPS, 30.0)
    return registered_parts(request, "mead", recordings, neutral, triangles, rates)


def is_actor(speaker: str) -> bool:
    """Whether a name is one of MEAD's actors, such as M003 or W009."""
    return re.fullmatch(r"[MW]\d{3}", speaker) is not None


def _processed(directory: Path) -> Path | None:
    for root in (directory, directory / "processed"):
        if (root / "reconstructions").is_dir():
            return root
    return None


def _takes(root: Path) -> Iterator[tuple[Path, tuple[str, str, str, str]]]:
    """Reconstruction files with actor, emotion, level and take; of the first method in order."""
    methods = sorted(p for p in (root / "reconstructions").iterdir() if p.is_dir())
    for method in methods[:1]:
        for path in sorted(method.glob(f"*/front/*/*/*/{_FILE}")):
            speaker, _, label, level, take = path.relative_to(method).parts[:5]
            yield path, (speaker, label, level, take)


def _shapes(path: Path, names: tuple[str, ...]) -> list[tuple[int, ...]]:
    """(frames, numbers) of arrays that are stored as (1, frames, numbers)."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            missing = [name for name in names if name not in file]
            if missing:
                raise DatasetError(f"{path} lacks {', '.join(missing)}; it has {', '.join(file)}")
            shapes: list[tuple[int, ...]] = [tuple(file[name].shape) for name in names]
    except OSError as error:
        raise DatasetError(f"{path} is no readable HDF5 file: {error}") from error
    for name, shape in zip(names, shapes):
        if len(shape) != 3 or shape[0] != 1:
            raise VertexCountError(f"{path}: {name} is {shape}, expected (1, frames, numbers)")
    return [shape[1:] for shape in shapes]


def _neutral(frames: FlameFrames, flame: Flame) -> FloatArray:
    import h5py

    with h5py.File(frames.path, "r") as file:
        shape: Any = np.asarray(file["shape"][0], dtype=np.float64)
    return flame.neutral(shape.mean(axis=0))
