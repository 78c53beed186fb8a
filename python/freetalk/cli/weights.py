"""Installed weights, found by name or folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PRETRAINED = Path(__file__).resolve().parents[1] / "pretrained"


def installed() -> Iterator[Path]:
    """Folders of the weights that ship with the package."""
    if PRETRAINED.is_dir():
        yield from sorted(file.parent for file in PRETRAINED.glob("*/talker.json"))


def find_weights(name: str) -> Path:
    """Folder of weights given by name or as a folder.

    Raises:
        ValueError: There are none of this name; the message lists those that are installed.
    """
    for folder in (Path(name), PRETRAINED / name):
        if (folder / "talker.json").is_file():
            return folder
    known = ", ".join(folder.name for folder in installed()) or "none"
    raise ValueError(f"no weights '{name}': neither a folder with talker.json nor one of: {known}")


def motion_options(folder: Path) -> dict[str, Any]:
    """Options of the landmark model: emotions, frames per second."""
    config: dict[str, Any] = json.loads((folder / "ats" / "config.json").read_text())
    options: dict[str, Any] = config["options"]
    return options
