"""Published speech encoders: conversion of older checkpoints, download."""

from __future__ import annotations

import json
import os
import pickle
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import torch

from freetalk import _native
from freetalk._hub import refusals
from freetalk._native.core import default_cache_dir
from freetalk.speech.encoder import SpeechEncoder

PUBLISHED = {
    "hubert-base-ls960": "facebook/hubert-base-ls960",
    "hubert-large-ll60k": "facebook/hubert-large-ll60k",
    "hubert-xlarge-ll60k": "facebook/hubert-xlarge-ll60k",
    "wav2vec2-base": "facebook/wav2vec2-base",
    "wav2vec2-base-960h": "facebook/wav2vec2-base-960h",
    "wav2vec2-large": "facebook/wav2vec2-large",
    "wav2vec2-large-lv60": "facebook/wav2vec2-large-lv60",
    "wav2vec2-large-xlsr-53": "facebook/wav2vec2-large-xlsr-53",
}

_WEIGHTS = ("model.safetensors", "model.safetensors.index.json")
_OLDER = ("pytorch_model.bin", "pytorch_model.bin.index.json")


def convert_checkpoint(
    source: str | os.PathLike[str], directory: str | os.PathLike[str], *, half: bool = False
) -> SpeechEncoder:
    """Turns a folder with ``pytorch_model.bin`` into one with ``model.safetensors``.

    The pickle is read with weights only: nothing in it is run. Heads of task checkpoints are left out.

    Args:
        source: a Hugging Face folder with config.json, or its pytorch_model.bin (one file or shards with an index).
        directory: folder to write config.json and model.safetensors to; made if missing.
        half: store float16.

    Returns:
        The encoder, in evaluation mode.

    Raises:
        RuntimeError: a file is missing or damaged or holds more than tensors, or the tensors do not fit config.json;
            the message names file and tensors.
    """
    folder = Path(source) if Path(source).is_dir() else Path(source).parent
    single = folder / _OLDER[0] if Path(source).is_dir() else Path(source)
    index = folder / _OLDER[1]
    if single.is_file() and single.name != index.name:
        files = [single]
    elif index.is_file():
        files = [folder / name for name in _shards(index)]
    else:
        raise RuntimeError(f"{single}: there is no such file; name a folder with {_OLDER[0]}")
    config = folder / "config.json"
    if not config.is_file():
        raise RuntimeError(f"{config}: there is no such file; it belongs beside {single.name}")
    tensors: dict[str, torch.Tensor] = {}
    for file in files:
        tensors.update(_read_pickle(file))
    with tempfile.TemporaryDirectory() as staged:
        _native.core.save_safetensors(str(Path(staged) / _WEIGHTS[0]), tensors)
        del tensors
        (Path(staged) / "config.json").write_bytes(config.read_bytes())
        try:
            encoder = SpeechEncoder.from_pretrained(staged)
        except RuntimeError as error:
            raise RuntimeError(str(error).replace(staged, str(folder))) from None
    encoder.save_pretrained(directory, half=half)
    return encoder


def download_encoder(name: str, directory: str | os.PathLike[str] | None = None) -> Path:
    """Fetches a published encoder from the Hugging Face hub.

    Args:
        name: one of ``PUBLISHED``, or a repository such as ``facebook/hubert-base-ls960``.
        directory: folder to write config.json and model.safetensors to; by default ``models/NAME`` in the folder of
            freetalk's caches.

    Returns:
        The folder, for :meth:`SpeechEncoder.from_pretrained`.

    Raises:
        ValueError: the name is neither known nor a repository's.
        RuntimeError: the hub cannot be reached, or the repository holds no encoder.
        ModuleNotFoundError: huggingface_hub is not installed.
    """
    repository = PUBLISHED.get(name, name)
    if repository.count("/") != 1:
        raise ValueError(
            f"unknown model '{name}': use one of {', '.join(PUBLISHED)}, or OWNER/NAME"
        )
    target = Path(directory) if directory is not None else models_directory() / name.split("/")[-1]
    config = _fetch(repository, "config.json")
    if config is None:
        raise RuntimeError(f"{repository} has no config.json: it is not a speech encoder")
    for wanted in _WEIGHTS + _OLDER:
        weights = _fetch(repository, wanted)
        if weights is None:
            continue
        if wanted.endswith(".index.json"):
            for shard in _shards(weights):
                _fetch(repository, shard)
        if wanted in _WEIGHTS:
            SpeechEncoder.from_pretrained(weights.parent).save_pretrained(target)
        else:
            convert_checkpoint(weights.parent, target)
        return target
    raise RuntimeError(f"{repository} has neither {_WEIGHTS[0]} nor {_OLDER[0]}")


def models_directory() -> Path:
    """Where downloaded encoders lie."""
    return default_cache_dir() / "models"


def _fetch(repository: str, file: str) -> Path | None:
    """The local copy of a file of a repository, or None when it has no such file."""
    import huggingface_hub
    from huggingface_hub import errors

    try:
        with refusals(repository):
            return Path(huggingface_hub.hf_hub_download(repository, file))
    except errors.EntryNotFoundError:
        return None


def _shards(index: Path) -> list[str]:
    try:
        names = set(json.loads(index.read_text())["weight_map"].values())
        return sorted(Path(name).name for name in names)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise RuntimeError(f"{index}: is not an index of weights; copy the file again") from None


def _read_pickle(file: Path) -> dict[str, torch.Tensor]:
    """Tensors of a ``torch.save`` file, by name."""
    if not file.is_file():
        raise RuntimeError(f"{file}: there is no such file; copy all shards")
    try:
        content: Any = torch.load(
            file, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(file)
        )
    except (pickle.UnpicklingError, EOFError, RuntimeError, ValueError, AttributeError) as error:
        reason = str(error).split("\n")[0]
        raise RuntimeError(
            f"{file}: cannot be read as weights alone ({reason}); copy it again, or take another"
        ) from None
    if isinstance(content, dict) and isinstance(content.get("state_dict"), dict):
        content = content["state_dict"]
    if not isinstance(content, dict):
        raise RuntimeError(f"{file}: holds a {type(content).__name__}, not tensors by name")
    return {
        str(name): value.detach().contiguous()
        for name, value in content.items()
        if isinstance(value, torch.Tensor)
    }
