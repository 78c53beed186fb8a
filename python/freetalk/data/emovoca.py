"""EmoVOCA (Nocentini et al. 2025): VOCAset's speech with the expressions of Florence 4D, in FLAME's meshing.

``sequences/SPEAKER_sentenceNN_EMOTION_INTENSITY.npy`` (T, 5023, 3), ``wav``, ``label`` (a number a sequence)
and ``intensity`` (1 to 3) of the same names; ``templates.pkl`` of VOCAset in the folder or in a ``vocaset``
beside it. Its generator reads VOCAset at 60 fps; copies at 30 are known from the sound's length.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from freetalk.data.emotions import EMOVOCA_LABELS, emotion_of, intensity_of
from freetalk.data.errors import DatasetError, LabelError
from freetalk.data.layouts import (
    FileName,
    Request,
    common_size,
    find_faces,
    paired_recordings,
    read_neutral,
    registered_parts,
)
from freetalk.data.registered import RegisteredParts

_NAME = re.compile(
    r"(?P<speaker>.+)_sentence(?P<sentence>\d+)_(?P<emotion>[A-Za-z]+\d?)_(?P<level>\d+)\Z"
)


def read_emovoca(request: Request) -> RegisteredParts:
    """EmoVOCA as its authors release it.

    Raises:
        LabelError: a label file contradicts the sequence's name, or is unknown.
        DatasetError: what else is missing or wrong, by name.
    """
    directory = request.directory
    beside = (directory / "vocaset", directory.parent / "vocaset", directory.parent / "VOCASET")
    neutral, faces = read_neutral(directory, beside)
    triangles = find_faces(directory, neutral, faces)

    def parse(stem: str) -> FileName | None:
        match = _NAME.match(stem)
        if match is None:
            return None
        emotion = emotion_of(match["emotion"], "emovoca", stem)
        level = intensity_of(match["level"], stem)
        _check_labels(directory, stem, match["emotion"], int(level))
        return FileName(match["speaker"], int(match["sentence"]), emotion, level)

    recordings = paired_recordings(request, common_size(neutral), parse)
    return registered_parts(request, "emovoca", recordings, neutral, triangles, (60.0, 30.0))


def _check_labels(directory: Path, stem: str, emotion: str, level: int) -> None:
    """The label files say what the name says."""
    code = _number(directory / "label" / f"{stem}.npy")
    if code is not None and code != EMOVOCA_LABELS.index(emotion):
        raise LabelError(
            f"{directory}/label/{stem}.npy says {code}, {emotion} is {EMOVOCA_LABELS.index(emotion)}"
        )
    given = _number(directory / "intensity" / f"{stem}.npy")
    if given is not None and given != level:
        raise LabelError(f"{directory}/intensity/{stem}.npy says {given}, the name {level}")


def _number(path: Path) -> int | None:
    if not path.is_file():
        return None
    try:
        return int(np.load(path, allow_pickle=False))
    except (ValueError, TypeError, EOFError) as error:
        raise DatasetError(f"{path} holds no single number: {error}") from error
