"""What a training starts from: given weights (``task.init``), what it can hear, and its speech encoder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from torch import nn

from freetalk import _native
from freetalk._pretrained import PRETRAINED
from freetalk.data import Dataset, MotionSequence
from freetalk.train.progress import notice
from freetalk.train.task_options import AtsTaskOptions, DenoisingTaskOptions


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


def audible(sequences: list[MotionSequence]) -> list[MotionSequence]:
    """Sequences with sound, and those whose silence is meant."""
    return [s for s in sequences if s.has_sound or s.source == "rest"]


def frame_rate(model: dict[str, Any], source_weights: dict[str, float], corpus: Dataset) -> float:
    """The model's frame rate: ``model.fps``, else the one that all sequences share.

    Raises:
        ValueError: they have several.
    """
    if "fps" in model:
        return float(model["fps"])
    taken = corpus.sequences("train")
    rates: dict[float, set[str]] = {}
    for s in [s for s in taken if source_weights.get(s.source, 0) > 0] or taken:
        rates.setdefault(s.fps, set()).add(s.source)
    if len(rates) > 1:
        found = "; ".join(f"{', '.join(sorted(who))}: {fps:g}" for fps, who in rates.items())
        raise ValueError(
            f"the sequences of {corpus.name} have several frame rates ({found}) and a model has one; "
            "name it as model.fps=RATE, and all motion is resampled to it"
        )
    return next(iter(rates), corpus.fps)


def named_encoder(name: str) -> Path:
    """The folder of a speech encoder: `name` itself, or that of installed weights of this name."""
    shipped = PRETRAINED / name / "speech"
    return shipped if not Path(name).exists() and shipped.is_dir() else Path(name)


def speech_encoder(options: DenoisingTaskOptions, out: Path) -> Path:
    """Folder of the speech encoder that the options name or imply, never one that nobody named.

    Raises:
        FileNotFoundError: none is named, and none lies where one would.
    """
    if options.speech_encoder:
        return named_encoder(options.speech_encoder)
    beside = [out / "speech"]
    kind = "ats" if isinstance(options, AtsTaskOptions) else "facetalk"
    if options.init:
        beside.append(initial_weights(options.init, kind).parent / "speech")
    for folder in beside:
        if (folder / "config.json").is_file():
            return folder
    raise FileNotFoundError(
        f"no speech encoder: there is none in {' or '.join(map(str, beside))}. Name one as "
        "task.speech_encoder=DIR (HuBERT or wav2vec 2.0 as transformers saves it, or what "
        "`freetalk train speech` wrote), or the shipped small one as task.speech_encoder=open-small"
    )
