"""Options of ``freetalk corpus`` that concern parametric heads, and of ``data from-video``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from freetalk.cli.numbers import natural, seed


def add_of_heads(nested: Any, command: Callable[..., Any]) -> None:
    """Adds ``heads`` and ``codes``; ``command`` makes one of a name, a handler and a help."""
    parser = command(
        nested,
        "heads",
        "data:heads",
        "write watertight heads of the built-in face",
        description=(
            "Writes heads as a neural parametric head is trained on them: closed, with eyes, mouth a little open "
            "(or with --expression). Trainings draw theirs anew; these are to look at and to judge by."
        ),
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the .ply files")
    parser.add_argument("--count", type=natural, default=8, help="how many (default: %(default)s)")
    parser.add_argument(
        "--held-out", action="store_true", help="the 32 identities that no training draws"
    )
    parser.add_argument(
        "--expression",
        metavar="NAME=WEIGHT",
        action="append",
        default=[],
        help="such as jawOpen=0.5; may repeat",
    )
    parser.add_argument("--seed", type=seed, default=0, help="same seed, same heads")
    parser = command(
        nested,
        "codes",
        "data:codes",
        "give every frame its code of a parametric head",
        description=(
            "Writes codes.npy into a packed corpus, from which 'freetalk train facetalk task.targets=head' learns. "
            "Captured takes are fitted to the posed face; other frames get the codes of their expression weights."
        ),
    )
    head_help = "folder of a head that 'freetalk train head' wrote"
    parser.add_argument("--head", required=True, metavar="DIR", help=head_help)
    parser.add_argument("--data", required=True, metavar="DIR", help="the packed corpus")
    parser.add_argument(
        "--no-fit", action="store_true", help="codes of expression weights for captured takes too"
    )


def add_video_options(parser: argparse.ArgumentParser) -> None:
    """Adds what the command reads and writes to its parser."""
    parser.description = (
        "Tracks the face in each video with MediaPipe (pip install 'freetalk[faces]'), or takes points "
        "tracked already (a folder with tracks.npz and audio/NAME.flac, see freetalk.video.read_tracks), "
        "fits ICT-FaceKit to them and writes landmarks, expression weights, head pose and sound as a "
        "dataset to train on. report.json says how well they fit and which clips were left out, and why; "
        "fit/TALKER.png shows ten clips."
    )
    parser.add_argument("sources", nargs="+", metavar="SOURCE", help="videos, or folders of either")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to make")
    parser.add_argument(
        "--talkers",
        choices=("folder", "file"),
        default="folder",
        help="the clips of a folder show one talker, or each its own",
    )
    parser.add_argument(
        "--split",
        choices=("auto", "train", "val", "test"),
        default="auto",
        help="of all clips; auto splits eight talkers and more by talker, fewer by clip",
    )
