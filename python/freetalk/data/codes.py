"""Codes of a parametric head that were fitted to every frame of a packed dataset.

==============  ======================================================================================
``codes.npy``   (N, Z) float32, expression codes of all frames, in the order of ``landmarks.npy``
``codes.json``  ``head`` (hash of the head that they belong to), ``rest`` (Z, the code of the face at rest) and
                ``sha256`` of the codes
==============  ======================================================================================
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from freetalk._files import replacing, write_json
from freetalk.data.errors import DatasetError, NotFiniteError
from freetalk.data.pack import FloatArray, Pack

CODES, ABOUT = "codes.npy", "codes.json"


@dataclass(frozen=True)
class HeadCodes:
    """What a dataset's codes belong to.

    Attributes:
        head: hash of the head's weights.
        rest: (Z,) the code of the face at rest.
    """

    head: str
    rest: FloatArray


def write_codes(directory: str | Path, codes: FloatArray, head: str, rest: FloatArray) -> None:
    """Makes fitted codes a part of a packed folder.

    Args:
        directory: the folder.
        codes: (N, Z), of all its frames.
        head: hash of the head's weights.
        rest: (Z,) the code of the face at rest.

    Raises:
        DatasetError: not one code for each frame, or codes of another size than ``rest``.
        NotFiniteError: a code is not finite; names the first frame.
    """
    pack = Pack(directory)
    wanted = (pack.landmarks.shape[0], len(rest))
    if codes.shape != wanted:
        raise DatasetError(f"{pack.directory}: expected codes {wanted}, found {codes.shape}")
    broken = np.flatnonzero(~np.isfinite(codes).all(axis=1))
    if len(broken) or not np.isfinite(rest).all():
        where = f"frame {broken[0]}" if len(broken) else "the face at rest"
        raise NotFiniteError(f"{pack.directory}: the code of {where} is not finite")
    values = np.ascontiguousarray(codes, np.float32)
    with replacing(pack.directory / CODES) as temporary, temporary.open("wb") as file:
        np.save(file, values)
    about = {
        "head": head,
        "rest": np.asarray(rest, np.float32).tolist(),
        "sha256": hashlib.sha256(values.tobytes()).hexdigest()[:16],
    }
    write_json(pack.directory / ABOUT, about)


def codes_of(pack: Pack) -> HeadCodes | None:
    """What the codes of a packed folder belong to; ``None`` where it has none."""
    path = pack.directory / ABOUT
    if pack.codes is None or not path.is_file():
        return None
    about = json.loads(path.read_text())
    return HeadCodes(str(about["head"]), np.array(about["rest"], np.float32))
