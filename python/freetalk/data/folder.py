"""A plain folder of one's own recordings: sound, motion, neutral faces, labels.

``motion/NAME.npy`` (or ``vertices_npy``, ``vertices``) holds positions: vertices (T, V, 3) or (T, 3 V), or 68
landmarks (T, 68, 3) or (T, 204), which train the audio stage alone. ``wav/NAME.wav`` is the sound; motion
without a ``wav`` folder trains the mesh stage alone. ``templates.pkl`` or ``templates/SPEAKER.ply`` (``.obj``,
``.npy``) are the neutral faces. A name is ``SPEAKER_anything`` unless ``labels.csv`` says more: a header with
``name`` and any of ``speaker``, ``emotion``, ``intensity``, ``text``, ``split``; without emotion a sequence is
neutral at intensity 1. ``dataset.json`` may set ``fps``, ``unit`` (m, cm, mm, in), ``split`` and ``name``.
"""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np

from freetalk.data.dataset import NUM_LANDMARKS, FloatArray
from freetalk.data.emotions import emotion_of, intensity_of
from freetalk.data.errors import DatasetError, LayoutError
from freetalk.data.index_files import Landmarks
from freetalk.data.layouts import (
    FileName,
    Request,
    common_size,
    find_faces,
    folder_settings,
    paired_recordings,
    read_neutral,
    registered_parts,
)
from freetalk.data.registered import Recording, RegisteredParts
from freetalk.data.splits import SPLITS
from freetalk.data.templates import Template

_COLUMNS = ("name", "speaker", "emotion", "intensity", "text", "split")
_FPS = (30.0, 25.0, 60.0, 24.0, 29.97, 50.0, 100.0, 120.0)


def read_folder(request: Request) -> RegisteredParts:
    """Recordings of one's own.

    Raises:
        DatasetError: what is missing or wrong, by name.
    """
    directory, settings = request.directory, folder_settings(request.directory)
    labels = _labels(directory / "labels.csv")
    neutral, faces = read_neutral(directory)
    sparse = common_size(neutral) == NUM_LANDMARKS and not faces
    triangles = np.zeros((0, 3), np.int64) if sparse else find_faces(directory, neutral, faces)

    def parse(stem: str) -> FileName:
        row = labels.get(stem, {})
        speaker = row.get("speaker") or _speaker(stem, neutral)
        where = f"{directory}/labels.csv: {stem}"
        emotion = emotion_of(row.get("emotion") or "neutral", None, where)
        return FileName(speaker, None, emotion, intensity_of(row.get("intensity") or 1, where))

    heard = (directory / "wav").is_dir()
    if not heard and "fps" not in settings:
        raise LayoutError(
            f"{directory} has no wav folder, so nothing tells the frame rate of its motion: state it "
            'as {"fps": 30} in dataset.json'
        )
    recordings = paired_recordings(request, common_size(neutral), parse, heard)
    recordings = [_labelled(r, labels.get(r.id, {}), request) for r in recordings]
    rates = (float(settings["fps"]),) if "fps" in settings else _FPS
    asked = dataclasses.replace(
        request,
        unit=str(settings.get("unit", request.unit)) if request.unit == "auto" else request.unit,
        split=request.split or str(settings.get("split", "")),
    )
    notes = {"layout": "folder"}
    parts = registered_parts(asked, "folder", recordings, neutral, triangles, rates, notes)
    return dataclasses.replace(parts, template=_sparse(parts)) if sparse else parts


def _sparse(parts: RegisteredParts) -> Template:
    """The template of motion that is the landmarks themselves."""
    rows = np.repeat(np.arange(NUM_LANDMARKS)[:, None], 3, axis=1)
    weights = np.zeros((NUM_LANDMARKS, 3), dtype=np.float32)
    weights[:, 0] = 1
    own = Landmarks(rows, weights, "the motion is the landmarks")
    return dataclasses.replace(parts.template, name="landmarks", landmarks=own)


def _speaker(stem: str, neutral: dict[str, FloatArray]) -> str:
    """The longest template name that the file's name starts with, else all before the last ``_``."""
    fitting = [name for name in neutral if stem == name or stem.startswith(name + "_")]
    return max(fitting, key=len) if fitting else stem.rpartition("_")[0] or stem


def _labelled(recording: Recording, row: dict[str, str], request: Request) -> Recording:
    split = row.get("split") or None
    if split is not None and split not in SPLITS:
        request.findings.add(
            DatasetError(f"labels.csv: {recording.id} has the split {split!r}; known: {SPLITS}")
        )
        split = None
    return dataclasses.replace(recording, text=row.get("text") or None, split=split)


def _labels(path: Path) -> dict[str, dict[str, str]]:
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        columns = reader.fieldnames or []
        unknown = [name for name in columns if name not in _COLUMNS]
        if "name" not in columns or unknown:
            raise DatasetError(
                f"{path} has the columns {', '.join(columns)}; expected name and any of "
                f"{', '.join(_COLUMNS[1:])}"
            )
        return {Path(row["name"]).stem: row for row in reader}
