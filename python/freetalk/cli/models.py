"""``freetalk models``."""

from __future__ import annotations

import argparse

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
