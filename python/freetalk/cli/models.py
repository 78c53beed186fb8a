"""``freetalk models``."""

from __future__ import annotations

import argparse
from pathlib import Path

from freetalk._pretrained import installed
from freetalk.cli.outputs import check_writable
from freetalk.cli.weights import motion_options


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


def push(arguments: argparse.Namespace) -> None:
    """Publishes a folder of weights with a model card."""
    from freetalk import hub

    address = hub.push(
        arguments.folder,
        arguments.repository,
        licence=arguments.licence,
        private=arguments.private,
    )
    print(f"{address}; load it with --pretrained {arguments.repository}")


def add_push(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk models push``."""
    folder_help = "weights, such as 'freetalk train --out' wrote"
    parser.add_argument("folder", metavar="DIR", help=folder_help)
    parser.add_argument("repository", metavar="OWNER/NAME", help="made if it is not there")
    parser.add_argument("--licence", default="mit", help="of the weights, as the hub names it")
    parser.add_argument("--private", action="store_true", help="where the repository is made")
