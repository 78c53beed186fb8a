"""VOCAset (Cudeiro et al. 2019) as released, and as FaceFormer, CodeTalker and ScanTalk keep it.

As released: ``data_verts.npy`` (N, 5023, 3) float32 of all frames at 60 fps, ``subj_seq_to_idx.pkl``
(speaker -> sentence -> frame -> row), ``raw_audio_fixed.pkl`` (speaker -> sentence -> ``audio`` int16 and
``sample_rate``) and ``templates.pkl`` (speaker -> (5023, 3)). FaceFormer's script makes of it
``vertices_npy/SPEAKER_sentenceNN.npy`` (T, 15069) and ``wav/SPEAKER_sentenceNN.wav``. Both are decimated
from 60 to 30 fps here by every second frame. Lengths are metres.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from freetalk import geometry
from freetalk._files import replacing, write_json
from freetalk.data.errors import DatasetError, LayoutError, MissingFileError
from freetalk.data.frames import PackedFrames, npy_header
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
from freetalk.data.safe_pickle import load_pickle

_RELEASED = ("data_verts.npy", "raw_audio_fixed.pkl", "subj_seq_to_idx.pkl", "templates.pkl")
_FPS = (60.0, 30.0)
_NAME = re.compile(r"(?P<speaker>.+)_sentence(?P<sentence>\d+)\Z")


def is_released(directory: Path) -> bool:
    """Whether a folder has the released layout (or part of it)."""
    return (directory / _RELEASED[0]).is_file() or (directory / _RELEASED[2]).is_file()


def read_released(request: Request) -> RegisteredParts:
    """The released layout.

    Raises:
        DatasetError: what is missing or wrong, by name.
    """
    directory = request.directory
    for name in _RELEASED:
        if not (directory / name).is_file():
            raise MissingFileError(f"{directory} lacks {name} of VOCAset's release")
    neutral, faces = read_neutral(directory)
    triangles = find_faces(directory, neutral, faces)
    path = directory / "data_verts.npy"
    shape, dtype = npy_header(path)
    if len(shape) != 3 or shape[2] != 3 or dtype.kind != "f":
        raise DatasetError(
            f"{path} is {dtype} {shape}; expected (frames, 5023, 3) floating numbers"
        )
    index = load_pickle(directory / "subj_seq_to_idx.pkl")
    audio = _audio_files(directory / "raw_audio_fixed.pkl")
    recordings, silent = [], 0
    for speaker, sentences in index.items():
        for sentence, rows in sentences.items():
            name = f"{speaker}_{sentence}"
            if name not in audio:
                silent += 1
                continue
            try:
                frames = PackedFrames(path, shape[1], _rows(rows, shape[0], name, directory))
            except DatasetError as error:
                request.findings.add(error)
                continue
            number = _NAME.match(name)
            recordings.append(
                Recording(
                    id=name,
                    speaker=str(speaker),
                    sentence=int(number["sentence"]) if number else None,
                    audio=audio[name],
                    frames=frames,
                )
            )
    notes = {"layout": "released", "sequences_without_sound": silent}
    return registered_parts(request, "vocaset", recordings, neutral, triangles, _FPS, notes)


def read_faceformer(request: Request) -> RegisteredParts:
    """FaceFormer's layout.

    Raises:
        DatasetError: what is missing or wrong, by name.
    """
    neutral, faces = read_neutral(request.directory)
    triangles = find_faces(request.directory, neutral, faces)
    recordings = paired_recordings(request, common_size(neutral), _parse)
    notes = {"layout": "FaceFormer"}
    return registered_parts(request, "vocaset", recordings, neutral, triangles, _FPS, notes)


def _parse(stem: str) -> FileName | None:
    match = _NAME.match(stem)
    return FileName(match["speaker"], int(match["sentence"])) if match else None


def _rows(frames: Any, total: int, name: str, directory: Path) -> np.ndarray:
    """Rows of a sequence in the order of its frames."""
    if not isinstance(frames, dict) or not frames:
        raise LayoutError(f"{directory}/subj_seq_to_idx.pkl: {name} maps no frames to rows")
    order = sorted(frames)
    if order != list(range(order[0], order[0] + len(order))):
        raise LayoutError(
            f"{directory}/subj_seq_to_idx.pkl: frames of {name} are missing in between"
        )
    rows = np.array([frames[frame] for frame in order], dtype=np.int64)
    if rows.min() < 0 or rows.max() >= total:
        raise LayoutError(
            f"{directory}/subj_seq_to_idx.pkl: {name} names row {rows.max()}, data_verts.npy has "
            f"{total}; it is cut short, or of another release"
        )
    return rows


def _audio_files(path: Path) -> dict[str, Path]:
    """Sound of each sequence as a wav in the cache, written when the pickle is first seen.

    So no process has to hold all sound in memory.
    """
    state = path.stat()
    key = hashlib.sha256(f"1 {path} {state.st_size} {state.st_mtime_ns}".encode()).hexdigest()[:16]
    folder = geometry.default_cache_dir() / "datasets" / f"vocaset-sound-{key}"
    listed = folder / "index.json"
    if not listed.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        names = []
        for speaker, sentences in load_pickle(path).items():
            for sentence, entry in sentences.items():
                name = f"{speaker}_{sentence}"
                _write_wav(folder / f"{name}.wav", entry, f"{path}: {name}")
                names.append(name)
        write_json(listed, names)
    return {name: folder / f"{name}.wav" for name in json.loads(listed.read_text())}


def _write_wav(path: Path, entry: Any, where: str) -> None:
    if not isinstance(entry, dict) or "audio" not in entry or "sample_rate" not in entry:
        raise LayoutError(f"{where} has no audio and sample_rate")
    samples = np.asarray(entry["audio"]).squeeze()
    if samples.ndim != 1 or samples.dtype.kind not in "if" or samples.size == 0:
        raise DatasetError(
            f"{where}: its audio is {samples.dtype} {samples.shape}; expected samples"
        )
    if samples.dtype.kind == "i" and samples.dtype.itemsize > 2 and np.abs(samples).max() < 2**15:
        samples = samples.astype(np.int16)  # 16-bit sound that was stored wider
    if samples.dtype.kind == "f":
        samples = samples.astype(np.float32)
    with replacing(path) as temporary:
        soundfile.write(temporary, samples, int(entry["sample_rate"]))
