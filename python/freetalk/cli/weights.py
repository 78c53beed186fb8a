"""Installed weights, found by name or folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from freetalk._pretrained import PRETRAINED, installed

__all__ = ["PRETRAINED", "find_weights", "installed", "motion_options"]


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
