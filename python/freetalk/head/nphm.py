"""Checkpoints of the public NPHM code, read by their own parameter names."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import torch

from freetalk.head.model import HeadOptions, ParametricHead, nphm_paper_options


def load_nphm(
    identity: str | os.PathLike[str],
    deformation: str | os.PathLike[str],
    anchors: str | os.PathLike[str],
    *,
    options: HeadOptions | None = None,
) -> ParametricHead:
    """A head from files of the public NPHM code.

    Args:
        identity: ``checkpoint_epoch_*.tar`` of the identity network. Where it holds the codes of its training,
            their mean and spread are kept for sampling.
        deformation: likewise of the expression network.
        anchors: ``.npy`` of the mean anchors, 39 x 3 numbers.
        options: of the head; None is ``nphm_paper_options()``, with the anchors' MLP as wide as the file's.

    Returns:
        The head in eval mode.

    Raises:
        RuntimeError: a file is missing or holds no checkpoint; a tensor is missing, unknown or of another shape
            than the options', and the message names it.
    """
    shape_file, moves_file = _read(identity), _read(deformation)
    shape = _tensors(shape_file, "decoder_state_dict", identity)
    moves = _tensors(moves_file, "decoder_state_dict", deformation)
    if options is None:
        options = nphm_paper_options()
        first = shape.get("mlp_pos.0.weight")
        if first is not None and first.dim() == 2:
            options.anchor_hidden = first.shape[0]
    head = ParametricHead(options)
    way = "deformation_" + ("backward" if options.direction == "backward" else "forward")
    own = dict(head.state_dict())
    _copy(own, shape, "identity.", identity, but={"identity.anchors"})
    _copy(own, moves, f"{way}.", deformation)
    _copy(own, {"anchors": _mean_anchors(anchors)}, "identity.", anchors, only={"identity.anchors"})
    codes = shape_file.get("latent_codes_state_dict")
    if isinstance(codes, Mapping):
        seen = codes["weight"].float()
        if seen.dim() == 2 and len(seen) > 1 and seen.shape[1] == head.identity_dim:
            own["identity_mean"].copy_(seen.mean(0))
            own["identity_scale"].copy_(seen.std(0))
    return head.eval()


def _read(path: str | os.PathLike[str]) -> Mapping[str, object]:
    try:
        saved = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise RuntimeError(f"{os.fspath(path)}: no such file") from None
    except Exception as error:
        raise RuntimeError(
            f"{os.fspath(path)}: is no checkpoint of torch that holds tensors alone ({type(error).__name__})"
        ) from error
    if not isinstance(saved, Mapping):
        raise RuntimeError(
            f"{os.fspath(path)}: holds a {type(saved).__name__}, not a checkpoint by name"
        )
    return saved


def _tensors(
    saved: Mapping[str, object], key: str, path: str | os.PathLike[str]
) -> dict[str, torch.Tensor]:
    state = saved.get(key, saved)
    if not isinstance(state, Mapping) or not all(torch.is_tensor(t) for t in state.values()):
        raise RuntimeError(
            f"{os.fspath(path)}: holds no {key}, but {', '.join(map(str, list(saved)[:6]))}"
        )
    return {str(name): tensor for name, tensor in state.items()}


def _mean_anchors(path: str | os.PathLike[str]) -> torch.Tensor:
    try:
        values = np.load(path, allow_pickle=False)
        return torch.from_numpy(np.asarray(values, np.float32).reshape(-1, 3))
    except (OSError, ValueError, TypeError) as error:
        raise RuntimeError(f"{os.fspath(path)}: holds no anchors as .npy ({error})") from error


@torch.no_grad()
def _copy(
    own: Mapping[str, torch.Tensor],
    found: Mapping[str, torch.Tensor],
    prefix: str,
    path: str | os.PathLike[str],
    *,
    only: set[str] | None = None,
    but: set[str] | None = None,
) -> None:
    expected = {
        name: tensor
        for name, tensor in own.items()
        if name.startswith(prefix) and (only is None or name in only) and name not in (but or set())
    }
    problems = []
    for name, tensor in expected.items():
        given = found.get(name[len(prefix) :])
        if given is None:
            problems.append(f"{name[len(prefix) :]} is missing")
        elif given.shape != tensor.shape:
            problems.append(
                f"{name[len(prefix) :]} has shape {tuple(given.shape)}, the options ask for {tuple(tensor.shape)}"
            )
    problems += [f"{name} is unknown" for name in found if prefix + name not in expected]
    if problems:
        raise RuntimeError(f"{os.fspath(path)}: does not fit the head: {'; '.join(problems)}")
    for name, tensor in expected.items():
        tensor.copy_(found[name[len(prefix) :]])
