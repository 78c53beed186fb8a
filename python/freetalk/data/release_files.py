"""Reads single files of the public releases: motion, sound, neutral faces and their meshing, labels, settings."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.audio import Audio, load_audio, resample
from freetalk.data.emotions import EMOVOCA_LABELS
from freetalk.data.errors import (
    DatasetError,
    LabelError,
    LayoutError,
    MissingFileError,
    MissingTemplateError,
    VertexCountError,
)
from freetalk.data.index_files import Landmarks
from freetalk.data.landmarks import NUM_LANDMARKS
from freetalk.data.pack import SAMPLE_RATE_HZ, Array, FloatArray
from freetalk.data.templates import (
    Template,
    find_template,
    find_template_mesh,
    read_faces,
    read_mesh,
)


def positions(path: Path, num_points: int) -> Array:
    """(T, P, 3) of a ``.npy``, mapped."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise DatasetError(
            f"{path} is no readable array, or cut short ({error}): fetch or make it again"
        ) from error
    shape = array.shape
    size = int(np.prod(shape[1:])) if array.ndim in (2, 3) else 0
    if array.dtype.kind != "f" or size == 0 or size % 3 or (array.ndim == 3 and shape[2] != 3):
        raise VertexCountError(
            f"{path} is {array.dtype} {shape}; motion is floating numbers of shape (frames, points, 3) "
            "or (frames, 3 * points)"
        )
    if size != 3 * num_points:
        raise VertexCountError(
            f"{path} has {size // 3} points a frame, its mesh has {num_points}; the file belongs to "
            "another mesh, or the template does"
        )
    return array.reshape(len(array), num_points, 3)


def sequence_rows(frames: Any, total: int, where: str) -> npt.NDArray[np.int64]:
    """Rows of a sequence in the order of its frames."""
    if not isinstance(frames, dict) or not frames:
        raise LayoutError(f"{where} maps no frames to rows")
    order = sorted(frames)
    if order != list(range(order[0], order[0] + len(order))):
        raise LayoutError(f"{where}: frames are missing in between")
    rows = np.array([frames[frame] for frame in order], dtype=np.int64)
    if rows.min() < 0 or rows.max() >= total:
        raise LayoutError(
            f"{where} names row {rows.max()}, data_verts.npy has {total}; it is cut short, or of another release"
        )
    return rows


def parameters(path: Path) -> Array:
    """(T, E + 3): expression, and the jaw's axis times angle, of an ``.hdf5``."""
    expression, jaw = read_hdf5(path, ("exp", "jaw"))
    if len(expression) != len(jaw) or jaw.shape[1] != 3:
        raise VertexCountError(
            f"{path}: exp is {expression.shape}, jaw is {jaw.shape} (frames, numbers)"
        )
    return np.concatenate([expression, jaw], axis=1)


def read_hdf5(path: Path, names: Iterable[str]) -> list[Array]:
    """(T, C) of arrays that are stored as (1, T, C)."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            missing = [name for name in names if name not in file]
            if missing:
                raise DatasetError(f"{path} lacks {', '.join(missing)}; it has {', '.join(file)}")
            arrays = {name: file[name][()] for name in names}
    except OSError as error:
        raise DatasetError(f"{path} is no readable HDF5 file: {error}") from error
    for name, array in arrays.items():
        if array.ndim != 3 or array.shape[0] != 1:
            raise VertexCountError(
                f"{path}: {name} is {array.shape}, expected (1, frames, numbers)"
            )
    return [array[0] for array in arrays.values()]


def read_sound(path: Path) -> FloatArray:
    """(S,) samples at 16 kHz of a sound file."""
    if not path.is_file():
        raise MissingFileError(f"its sound {path} is missing")
    try:
        return np.asarray(load_audio(path, SAMPLE_RATE_HZ).samples, np.float32)
    except RuntimeError as error:
        raise DatasetError(str(error)) from error


def pickled_sound(entry: Any, where: str) -> FloatArray:
    """(S,) samples at 16 kHz of an entry of VOCAset's ``raw_audio_fixed.pkl``."""
    if not isinstance(entry, dict) or "audio" not in entry or "sample_rate" not in entry:
        raise LayoutError(f"{where} has no audio and sample_rate")
    samples = np.asarray(entry["audio"]).squeeze()
    if samples.ndim != 1 or samples.dtype.kind not in "if" or samples.size == 0:
        raise DatasetError(
            f"{where}: its audio is {samples.dtype} {samples.shape}; expected samples"
        )
    if samples.dtype.kind == "i":  # 16-bit sound, also where it was stored wider
        samples = samples / np.float32(2**15 if np.abs(samples).max() <= 2**15 else 2**31)
    sound = resample(Audio(samples.astype(np.float32), int(entry["sample_rate"])), SAMPLE_RATE_HZ)
    return np.asarray(sound.samples, np.float32)


def faces_and_template(
    kind: str, directory: Path, elsewhere: Iterable[Path] = ()
) -> tuple[dict[str, FloatArray], Template]:
    """Neutral faces by speaker, and their meshing."""
    neutral, faces = neutral_faces([directory, *elsewhere])
    return neutral, mesh_template(kind, directory, neutral, faces)


def mesh_template(
    kind: str, directory: Path, neutral: dict[str, FloatArray], faces: dict[str, Array]
) -> Template:
    """The meshing: its triangles are those of the speakers' meshes, or of the template's mesh file."""
    count = common_size(neutral)
    if faces:
        return find_template(directory, next(iter(faces.values())), count, kind)
    folder = kind if kind in ("biwi", "multiface") else "flame"
    path = find_template_mesh(directory, folder)
    if path is None:
        raise MissingFileError(
            f"{directory} names no triangles: put the template's mesh (FLAME_sample.ply of the VOCA "
            "repository, or template.ply) there"
        )
    vertices, triangles = read_mesh(path)
    if len(vertices) != count:
        raise DatasetError(f"{path} has {len(vertices)} vertices, the neutral faces {count}")
    return find_template(directory, triangles, count, kind)


def sparse_template() -> Template:
    """The template of motion that is the landmarks themselves."""
    rows = np.repeat(np.arange(NUM_LANDMARKS)[:, None], 3, axis=1)
    weights = np.zeros((NUM_LANDMARKS, 3), dtype=np.float32)
    weights[:, 0] = 1
    own = Landmarks(rows, weights, "the motion is the landmarks")
    return Template("landmarks", np.zeros((0, 3), np.int64), NUM_LANDMARKS, own)


def neutral_faces(places: Iterable[Path]) -> tuple[dict[str, FloatArray], dict[str, Array]]:
    """Neutral faces by speaker, and the triangles of those that are mesh files, of the first place that has any."""
    searched = list(places)
    for place in searched:
        for path in (place / "templates.pkl", place / "templates"):
            if path.exists():
                return read_faces(path)
    raise MissingTemplateError(
        f"{searched[0]} has no neutral faces: neither templates.pkl nor templates/SPEAKER.ply"
    )


def common_size(neutral: dict[str, FloatArray]) -> int:
    """Vertices of most neutral faces, so that one bad template does not decide."""
    sizes = [len(points) for points in neutral.values()]
    return max(set(sizes), key=sizes.count)


def check_labels(directory: Path, stem: str, emotion: str, level: int) -> None:
    """EmoVOCA's label files say what the name says."""
    for folder, said, what in (
        ("label", EMOVOCA_LABELS.index(emotion), emotion), ("intensity", level, "the name"),
    ):  # fmt: skip
        path = directory / folder / f"{stem}.npy"
        if not path.is_file():
            continue
        try:
            found = int(np.load(path, allow_pickle=False))
        except (ValueError, TypeError, EOFError) as error:
            raise DatasetError(f"{path} holds no single number: {error}") from error
        if found != said:
            raise LabelError(f"{path} says {found}, {what} is {said}")


def read_labels(path: Path) -> dict[str, dict[str, str]]:
    """Rows of ``labels.csv`` by the take's name; empty without the file."""
    columns = ("name", "speaker", "emotion", "intensity", "text", "split")
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        found = list(reader.fieldnames or [])
        if "name" not in found or not set(found) <= set(columns):
            raise DatasetError(
                f"{path} has the columns {', '.join(found)}; expected name and any of "
                f"{', '.join(columns[1:])}"
            )
        return {Path(row["name"]).stem: row for row in reader}


def read_settings(directory: Path) -> dict[str, Any]:
    """``dataset.json`` of a folder; empty without the file."""
    path, known = directory / "dataset.json", {"fps", "unit", "name"}
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except ValueError as error:
        raise DatasetError(f"{path} is no JSON: {error}") from error
    if not isinstance(content, dict) or not set(content) <= known:
        raise DatasetError(f"{path} must map some of {', '.join(sorted(known))}")
    return content
