"""``freetalk evaluate``."""

from __future__ import annotations

import argparse
from pathlib import Path

from freetalk.cli.outputs import check_readable, check_writable
from freetalk.cli.weights import find_weights

_FOLDERS = {"stm": ("stm",), "ats": ("speech", "ats"), "emotions": ("speech", "ats")}


def run(arguments: argparse.Namespace) -> None:
    """Measures weights on the test split of a corpus and prints a table."""
    if not (Path(arguments.data) / "manifest.json").is_file():
        raise OSError(f"'{arguments.data}' is no corpus: make one with 'freetalk corpus build'")
    weights = _weights(arguments.pretrained, arguments.parts)
    for file in arguments.audio:
        check_readable(file, "a recording of speech")
    if arguments.out is not None:
        check_writable(Path(arguments.out))
    from freetalk.evaluate import open_corpus

    options = ["--corpus", arguments.data, "--pretrained", str(weights)]
    options += ["--parts", *arguments.parts, "--take", arguments.take]
    options += ["--samples", str(arguments.samples), "--steps", str(arguments.steps)]
    options += ["--audio", *arguments.audio] if arguments.audio else []
    options += ["--out", arguments.out] if arguments.out is not None else []
    open_corpus.main(options)


def _weights(name: str, parts: list[str]) -> Path:
    """Installed weights by name, or a folder that training writes to."""
    needed = {folder for part in parts for folder in _FOLDERS[part]}
    if all((Path(name) / folder / "config.json").is_file() for folder in needed):
        return Path(name)
    return find_weights(name)
