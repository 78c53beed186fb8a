"""Where the weights that ship with the package lie."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

PRETRAINED = Path(__file__).resolve().parent / "pretrained"
"""Folder of the weights that ship with the package."""


def installed() -> Iterator[Path]:
    """Folders of the weights that ship with the package."""
    if PRETRAINED.is_dir():
        yield from sorted(file.parent for file in PRETRAINED.glob("*/talker.json"))
