"""Options of ``freetalk live``."""

from __future__ import annotations

import argparse

from freetalk.cli.motion_options import add_performance
from freetalk.cli.numbers import at_least_one


def add_live(parser: argparse.ArgumentParser) -> None:
    """Adds them, but for the face's pose and the weights."""
    parser.description = (
        "Animates a face mesh with speech as it is spoken, about half a second behind it, and prints frames per "
        "second and latency. The speech comes from the microphone, from a recording in its own time, or as "
        "signed 16-bit mono samples at 16 kHz from a pipe: 'arecord -f S16_LE -r 16000 | freetalk live "
        "--audio - --mesh face.obj'."
    )
    source = parser.add_mutually_exclusive_group()
    audio_help = "a recording, or '-' for samples on stdin; without it the microphone"
    source.add_argument("--audio", metavar="FILE", help=audio_help)
    source.add_argument("--mic", action="store_true", help="the microphone, which is the default")
    to_help = "send frames: livelink://HOST:11111 (Unreal) or vmc://HOST:39539 (VRM); repeatable"
    parser.add_argument("--to", action="append", default=[], metavar="ADDRESS", help=to_help)
    mesh_help = "face: OBJ, PLY, OFF, STL, glTF; without it the built-in mean face"
    parser.add_argument("--mesh", metavar="FILE", help=mesh_help)
    parser.add_argument("--emotion", default="neutral", help="as of 'freetalk animate'")
    parser.add_argument(
        "--intensity", type=at_least_one, metavar="X", help="as of 'freetalk animate'"
    )
    add_performance(parser)
    parser.add_argument(
        "--vertices", action="store_true", help="also compute the vertices of every frame"
    )
    precisions = ("float32", "bfloat16")
    parser.add_argument(
        "--precision", choices=precisions, default="float32", help="of the networks"
    )
