from __future__ import annotations
import collections.abc
import os
import pathlib
import torch
import typing

__all__: list[str] = [
    "NUM_LANDMARKS",
    "UNITS",
    "default_cache_dir",
    "load_safetensors",
    "nearest_name",
    "read_model_options",
    "save_model_files",
    "save_safetensors",
    "set_log_sink",
]

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

def read_model_options(directory: os.PathLike | str | bytes, format: str) -> str:
    """
    The options in config.json of a model's folder, as JSON text.
    """

def save_model_files(
    directory: os.PathLike | str | bytes,
    config: str,
    tensors: collections.abc.Mapping[str, torch.Tensor],
) -> None:
    """
    Writes model.safetensors and config.json (JSON text), each of which says which save it is of.
    """

def save_safetensors(
    path: os.PathLike | str | bytes,
    tensors: collections.abc.Mapping[str, torch.Tensor],
    metadata: collections.abc.Mapping[str, str] = {},
) -> None:
    """
    Writes tensors by name to a safetensors file, atomically.
    """

def set_log_sink(sink: collections.abc.Callable[[int, str], None] | None) -> None:
    """
    Hands what the native library has to say to sink(level, text), levels as in logging; None: warnings to stderr.
    """

NUM_LANDMARKS: int = 68
UNITS: dict = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
