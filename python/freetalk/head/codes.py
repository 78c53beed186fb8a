"""Files of codes, which know the head that they belong to."""

from __future__ import annotations

import hashlib
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from freetalk._files import replacing
from freetalk.head.model import ParametricHead

_FORMAT = "freetalk-head-codes"


@dataclass(frozen=True)
class Codes:
    """An identity and the expressions of a sequence.

    Attributes:
        z_id: (D,) float32.
        z_exp: (T, E) float32.
        fps: frames per second.
    """

    z_id: torch.Tensor
    z_exp: torch.Tensor
    fps: float


def content_hash(head: ParametricHead) -> str:
    """A hash of a head's options and weights, 16 hexadecimal digits."""
    digest = hashlib.sha256(repr(head.options).encode())
    for name, tensor in sorted(head.state_dict().items()):
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def save_codes(path: str | os.PathLike[str], head: ParametricHead, codes: Codes) -> None:
    """Writes codes as ``.npz``, together with the hash of their head."""
    with replacing(Path(path)) as temporary, temporary.open("wb") as stream:
        np.savez(
            stream,
            format=_FORMAT,
            head=content_hash(head),
            z_id=codes.z_id.detach().cpu().numpy().astype(np.float32),
            z_exp=codes.z_exp.detach().cpu().numpy().astype(np.float32),
            fps=np.float64(codes.fps),
        )


def load_codes(path: str | os.PathLike[str], head: ParametricHead) -> Codes:
    """Reads what :func:`save_codes` wrote for this head.

    Raises:
        RuntimeError: the file is missing or is none of codes.
        ValueError: the codes are of another head, of another size, or not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
    except FileNotFoundError:
        raise RuntimeError(f"{os.fspath(path)}: no such file") from None
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise RuntimeError(f"{os.fspath(path)}: cannot be read as .npz ({error})") from error
    if str(found.get("format")) != _FORMAT:
        raise RuntimeError(f"{os.fspath(path)}: holds no codes of a head")
    own, theirs = content_hash(head), str(found["head"])
    if own != theirs:
        raise ValueError(
            f"{os.fspath(path)}: holds codes of the head {theirs}, but this head is {own}: fit them anew"
        )
    z_id, z_exp = (torch.from_numpy(found[name]) for name in ("z_id", "z_exp"))
    if z_id.shape != (head.identity_dim,) or z_exp.shape[1:] != (head.options.expression_dim,):
        raise ValueError(
            f"{os.fspath(path)}: expected codes of {head.identity_dim} and {head.options.expression_dim} channels, "
            f"found {tuple(z_id.shape)} and {tuple(z_exp.shape)}"
        )
    if not (bool(z_id.isfinite().all()) and bool(z_exp.isfinite().all())):
        raise ValueError(f"{os.fspath(path)}: codes hold numbers that are not finite")
    return Codes(z_id, z_exp, float(found["fps"]))
