"""Expression weights of a packed dataset that was imported as landmarks."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from freetalk._files import replacing, write_json
from freetalk.data.errors import DatasetError, NotFiniteError
from freetalk.data.pack import FloatArray, Pack


def write_weights(
    directory: str | Path, names: Sequence[str], weights: Mapping[str, FloatArray]
) -> None:
    """Makes the weights that moved the landmarks a part of a packed folder of landmarks alone.

    Args:
        directory: the folder.
        names: of the E expressions.
        weights: (T, E) of each sequence by its id; frames after its last are left out.

    Raises:
        DatasetError: the folder has motion already, or a sequence too few weights, or others than E.
        NotFiniteError: a weight is not finite; names its sequence.
    """
    pack = Pack(directory)
    if pack.motion is not None:
        raise DatasetError(f"{pack.directory} has motion beside its landmarks already")
    frames = np.zeros((pack.landmarks.shape[0], len(names)), np.float32)
    for entry in pack.manifest["sequences"]:
        first, count = int(entry["start_frame"]), int(entry["num_frames"])
        own = weights.get(entry["id"], np.zeros((0, len(names)), np.float32))
        if len(own) < count or own.shape[1] != len(names):
            raise DatasetError(
                f"{entry['id']}: expected weights ({count}, {len(names)}), found {own.shape}"
            )
        if not np.isfinite(own[:count]).all():
            raise NotFiniteError(f"{entry['id']}: a weight is not finite")
        frames[first : first + count] = own[:count]
    with replacing(pack.directory / "motion.npy") as temporary, temporary.open("wb") as file:
        np.save(file, frames)
    pack = Pack(directory)
    manifest = json.loads(json.dumps(pack.manifest))
    manifest["expressions"] = list(names)
    for entry in manifest["sequences"]:
        entry["sha256"] = pack.digest(entry)
    write_json(pack.directory / "manifest.json", manifest)
