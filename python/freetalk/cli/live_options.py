"""Options of ``freetalk live``, ``view`` and ``serve``."""

from __future__ import annotations

import argparse

from freetalk.cli.motion_options import add_performance
from freetalk.cli.numbers import at_least_one, natural, picture_size


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


def add_view(parser: argparse.ArgumentParser) -> None:
    """Options of ``view``."""
    parser.description = (
        "Opens a page in the browser that plays animations with sound: turn them, compare several beside each "
        "other, colour them by their distance from a truth, save pictures and videos. Without a display it "
        "prints the page's address, which is reachable from this machine alone."
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help="animations .npz, to compare")
    truth_help = "an animation of the same mesh: colour the others by their distance from it"
    parser.add_argument("--truth", metavar="FILE", help=truth_help)
    texture_help = "picture for the mesh's texture coordinates: PNG, JPEG, WebP"
    parser.add_argument("--texture", metavar="FILE", help=texture_help)
    parser.add_argument("--html", metavar="FILE", help="write the page instead of opening it")
    parser.add_argument("--port", type=natural, help="of the page; by default any that is free")
    parser.add_argument("--png", metavar="FILE", help="write a picture of the first instead")
    parser.add_argument("--mp4", metavar="FILE", help="write a video of the first instead")
    parser.add_argument("--time", type=float, default=0.0, help="moment of the picture, seconds")
    parser.add_argument(
        "--size", type=picture_size, default="720x720", help="pixels of picture and video"
    )
    parser.add_argument("--yaw", type=float, default=12.0, help="degrees the camera stands aside")


def add_serve(parser: argparse.ArgumentParser) -> None:
    """Options of ``serve``."""
    parser.description = (
        "Opens a page in the browser: drop in speech or record it, choose a face, direct the emotion over time, "
        "make several takes, compare them and download them, or speak and see the face live. It is reachable "
        "from this machine alone unless --host says otherwise, and by those who have its address "
        "(pip install '.[serve]')."
    )
    mesh_help = "face to begin with: OBJ, PLY, OFF, STL, glTF; without it the built-in mean face"
    parser.add_argument("--mesh", metavar="FILE", help=mesh_help)
    parser.add_argument("--audio", metavar="FILE", help="speech to begin with")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument("--port", type=natural, help="by default any that is free")
    parser.add_argument("--max-upload-mb", type=natural, default=64, help="largest file it takes")
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
