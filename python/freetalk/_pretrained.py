"""Folders of weights: those that ship with the package, and any other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

PRETRAINED = Path(__file__).resolve().parent / "pretrained"
"""Folder of the weights that ship with the package."""

#: What a folder of weights holds beside ``talker.json`` and the template that meshes are aligned to.
STAGES = ("speech", "ats", "stm")


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
    """The folder of complete weights: itself, or that of installed ones of this name.

    Raises:
        ValueError: there is none; the message says what a folder lacks, or which weights are installed.
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
    known = ", ".join(folder.name for folder in installed()) or "none"
    raise ValueError(f"no weights '{name}': neither a folder with talker.json nor one of: {known}")
