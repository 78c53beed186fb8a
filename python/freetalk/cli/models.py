"""``freetalk models``."""

from __future__ import annotations

import argparse
from pathlib import Path

from freetalk.cli.outputs import check_writable
from freetalk.cli.weights import installed, motion_options


def list_models(_: argparse.Namespace) -> None:
    """Lists the installed weights."""
    folders = list(installed())
    if not folders:
        raise ValueError("no weights are installed with this freetalk: install it again")
    for folder in folders:
        about = motion_options(folder)
        megabytes = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6
        print(f"{folder.name}: {megabytes:.1f} MB, {about['fps']:g} fps, {folder}")
        print(f"  emotions: {', '.join(about['emotions'])}")


def download(arguments: argparse.Namespace) -> None:
    """Fetches a published speech encoder."""
    out = Path(arguments.out) if arguments.out else None
    if out is not None:
        check_writable(out / "config.json")
    from freetalk.speech.checkpoint import download_encoder

    folder = download_encoder(arguments.name, out)
    megabytes = (folder / "model.safetensors").stat().st_size / 1e6
    print(f"{folder}: {arguments.name}, {megabytes:.0f} MB")
