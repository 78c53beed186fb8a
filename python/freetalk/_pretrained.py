"""Folders of weights: those that ship with the package, and any other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

PRETRAINED = Path(__file__).resolve().parent / "pretrained"
"""Folder of the weights that ship with the package."""

#: What a folder of weights holds beside ``talker.json`` and the template that meshes are aligned to.
STAGES = ("speech", "ats", "stm")
#: What it may hold beside them.
FURTHER_STAGES = ("facetalk", "head")


def installed() -> Iterator[Path]:
    """Folders of the weights that ship with the package."""
    if PRETRAINED.is_dir():
        yield from sorted(file.parent for file in PRETRAINED.glob("*/talker.json"))


def missing_stages(folder: Path) -> list[str]:
    """The stages that a folder of weights lacks."""
    files = ("config.json", "model.safetensors")
    return [
        stage for stage in STAGES if not all((folder / stage / file).is_file() for file in files)
    ]


def find_weights(name: str | os.PathLike[str]) -> Path:
    """The folder of complete weights: itself, that of installed ones of this name, or a copy from the hub.

    Args:
        name: a folder, the name of installed weights, or ``owner/name`` on huggingface.co.

    Raises:
        ValueError: there is none; the message says what a folder lacks, or which weights are installed.
        RuntimeError: the hub cannot be reached, or the repository holds no weights.
        ModuleNotFoundError: the name is a repository's and huggingface_hub is not installed.
    """
    for folder in (Path(name), PRETRAINED / name):
        if (folder / "talker.json").is_file():
            return folder
    folder = Path(name)
    if folder.is_dir():
        lacking = missing_stages(folder)
        commands = " and ".join(f"`freetalk train {stage} --out {folder}`" for stage in lacking)
        raise ValueError(
            f"'{folder}' lacks {' and '.join(lacking)}, which {commands} would write"
            if 0 < len(lacking) < len(STAGES)
            else f"'{folder}' is no folder of weights: it has no talker.json"
        )
    from freetalk import _hub  # which knows of this module

    if _hub.is_repository(name):
        return _hub.download(os.fspath(name))
    known = ", ".join(folder.name for folder in installed()) or "none"
    raise ValueError(
        f"no weights '{name}': neither a folder with talker.json nor OWNER/NAME on huggingface.co nor one of: {known}"
    )
