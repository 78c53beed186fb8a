"""Training that starts from given weights instead of random ones (``task.init``)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torch import nn

from freetalk import _native
from freetalk._pretrained import PRETRAINED
from freetalk.train.progress import notice


def initial_weights(name: str, kind: str) -> Path:
    """The folder of a kind's weights that `name` stands for.

    Args:
        name: folder of the weights, an output folder of a training, or the name of installed weights
            (``open-small``).
        kind: ``ats``, ``stm``, ``speech``, ``facetalk`` or ``head``.

    Raises:
        FileNotFoundError: none of them holds weights of that kind.
    """
    tried = [Path(name) / kind, Path(name), PRETRAINED / name / kind]
    for path in tried:
        if (path / "config.json").is_file() and (path / "model.safetensors").is_file():
            return path
    looked = ", ".join(str(path) for path in tried)
    raise FileNotFoundError(
        f"task.init={name}: no config.json and model.safetensors of {kind} in any of {looked}"
    )


def start_from(model: nn.Module, name: str, kind: str) -> Path:
    """Copies weights into a model; those of a speech encoder go into its ``encoder``.

    Options that differ without changing a tensor's shape (dropout, the band's radius) are those of
    `model`; they are named on standard error.

    Args:
        model: what is trained.
        name: see :func:`initial_weights`.
        kind: ``ats``, ``stm``, ``speech``, ``facetalk`` or ``head``.

    Returns:
        The folder that was read.

    Raises:
        FileNotFoundError: no such weights.
        ValueError: tensors or emotions of the weights and of the model differ; names the first.
    """
    path = initial_weights(name, kind)
    receiver: Any = model.encoder if kind == "speech" else model
    config = json.loads((path / "config.json").read_text())
    theirs = config.get("options", config)
    own = receiver.options.to_dict()
    differing = [key for key, value in own.items() if key in theirs and theirs[key] != value]
    shown = ", ".join(f"{key} {theirs[key]} -> {own[key]}" for key in differing)
    state = _native.core.load_safetensors(str(path / "model.safetensors"))
    wanted = receiver.state_dict()
    for tensor in sorted(state.keys() | wanted.keys()):
        there, here = (
            tuple(group[tensor].shape) if tensor in group else "none" for group in (state, wanted)
        )
        if there != here:
            raise ValueError(
                f"task.init={name}: tensor {tensor} is {there} in {path}, but {here} in this model; "
                f"options that differ: {shown or 'none'}"
            )
    if "emotions" in differing:
        raise ValueError(f"task.init={name}: the emotions differ: {shown}")
    receiver.load_state_dict(state)
    note = f"; options that differ: {shown}" if shown else ""
    notice(f"starting {kind} from {path}{note}")
    return path
