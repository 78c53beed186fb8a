from __future__ import annotations
import collections.abc
import os
import pathlib
import torch
import typing

__all__: list[str] = ["default_cache_dir", "load_safetensors", "nearest_name", "save_safetensors"]

def default_cache_dir() -> pathlib.Path:
    """
    The folder of the disk caches: $FREETALK_CACHE, or $XDG_CACHE_HOME/freetalk, or ~/.cache/freetalk.
    """

def load_safetensors(path: os.PathLike | str | bytes) -> dict[str, torch.Tensor]:
    """
    Tensors of a safetensors file by name, memory-mapped.
    """

def nearest_name(name: str, known: collections.abc.Sequence[str]) -> str:
    """
    The known name with the smallest edit distance.
    """

def save_safetensors(
    path: os.PathLike | str | bytes,
    tensors: collections.abc.Mapping[str, torch.Tensor],
    metadata: collections.abc.Mapping[str, str] = {},
) -> None:
    """
    Writes tensors by name to a safetensors file, atomically.
    """
