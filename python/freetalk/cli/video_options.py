"""Options of ``freetalk data from-video``."""

from __future__ import annotations

import argparse


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
