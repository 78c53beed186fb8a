"""Codes of a parametric head from points of a surface (scans, registered meshes, depth), and files of codes."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from freetalk import _native
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


FitOptions = _native.head.FitOptions


@dataclass(frozen=True)
class Fit:
    """Codes and how near their surface comes to the points.

    Attributes:
        z_id: (D,).
        z_exp: (T, E).
        error_mm: (T,) mean distance of each frame's points by the head's own field.
    """

    z_id: torch.Tensor
    z_exp: torch.Tensor
    error_mm: torch.Tensor


def fit_expressions(
    head: ParametricHead,
    z_id: torch.Tensor,
    points: Sequence[torch.Tensor | np.ndarray],
    *,
    prior: torch.Tensor | None = None,
    options: _native.head.FitOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> Fit:
    """Expression codes of the frames of a known identity.

    Args:
        head: on the CPU, in eval mode.
        z_id: (D,) the identity's code.
        points: T of (P_t, 3) points of the posed surface, metres, in the head's frame.
        prior: (T, E) codes to begin from and to stay near; None is the head's ``rest_expression``.
        options: ``FitOptions``: Gauss-Newton over all frames together, or FaceTalk's Adam by ``method="adam"``.
        seed: of the points that are drawn.
        on_step: called with steps done and steps in all; may raise to stop.

    Raises:
        ValueError: a frame without points, numbers that are not finite, or a shape that does not fit.
    """
    found = _native.head.fit_expressions(
        head._plain_impl,
        z_id,
        [torch.as_tensor(own, dtype=torch.float32) for own in points],
        prior=prior,
        options=options or FitOptions(),
        seed=seed,
        on_step=on_step,
    )
    return Fit(found.z_id, found.z_exp, found.error_mm)


def fit_identity(
    head: ParametricHead,
    points: Sequence[torch.Tensor | np.ndarray],
    *,
    prior: torch.Tensor | None = None,
    identity_prior: torch.Tensor | None = None,
    options: _native.head.FitOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> Fit:
    """The identity that frames share, and their expressions, by Gauss-Newton.

    Args:
        head: on the CPU, in eval mode. Where it has ``identity_map``, the map's coefficients are sought.
        points: T of (P_t, 3) points of the posed surfaces, metres, in the head's frame.
        prior: (T, E) expressions to begin from and to stay near; None is the head's ``rest_expression``.
        identity_prior: (D,) begun from; None is the head's mean.
        options: ``FitOptions``.
        seed: of the points that are drawn.
        on_step: called with steps done and steps in all; may raise to stop.

    Raises:
        ValueError: as :func:`fit_expressions`.
    """
    found = _native.head.fit_identity(
        head._plain_impl,
        [torch.as_tensor(own, dtype=torch.float32) for own in points],
        prior=prior,
        identity_prior=identity_prior,
        options=options or FitOptions(),
        seed=seed,
        on_step=on_step,
    )
    return Fit(found.z_id, found.z_exp, found.error_mm)
