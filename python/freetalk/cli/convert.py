"""``freetalk convert``: an animation from one format to another."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from freetalk._pretrained import find_weights
from freetalk.cli.animate import Report, write
from freetalk.cli.numbers import picture_size, positive
from freetalk.cli.outputs import check_kept, check_readable, parse_outputs


def add_convert(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk convert``."""
    parser.description = (
        "Reads an animation (.npz, glTF, USD, .pc2, or a folder of OBJ or PLY files) and writes it in others, told "
        "by their names as those of 'freetalk animate --out'."
    )
    parser.add_argument("source", metavar="FROM", help="the animation")
    parser.add_argument("outputs", metavar="TO", nargs="+", help="where to write, as for animate")
    mesh_help = "the mesh that a .pc2 moves, or whose materials a .npz is to have again"
    parser.add_argument("--mesh", metavar="FILE", help=mesh_help)
    parser.add_argument(
        "--fps", type=positive, help="of a .pc2 or a folder (30); to sample a glTF at"
    )


def add_writing(parser: argparse.ArgumentParser) -> None:
    """Adds how outputs are written, those of ``freetalk animate`` too."""
    rig_help = (
        "targets of glTF and USD: pca, the fewest for 0.1 mm; or arkit, ARKit's 51 by name first"
    )
    parser.add_argument("--rig", choices=("pca", "arkit"), default="pca", help=rig_help)
    compact_help = "glTF with 16-bit vertices and targets, about half the size"
    parser.add_argument("--compact", action="store_true", help=compact_help)
    parser.add_argument("--size", type=picture_size, default="720x720", help="pixels of a video")
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")


def run(arguments: argparse.Namespace) -> None:
    """Reads, then writes every output.

    Raises:
        ValueError: an extension that is not known, or a mesh that does not fit.
        RuntimeError: the animation cannot be read.
    """
    outputs = parse_outputs(arguments.outputs)
    check_kept(outputs, [Path(arguments.source)])
    import freetalk

    given: dict[str, Any] = {"fps": arguments.fps}
    mesh = None
    if arguments.mesh is not None:
        mesh = freetalk.load_mesh(check_readable(arguments.mesh, "a mesh"))
    animation = freetalk.load_animation(arguments.source, mesh=mesh, **given)
    if mesh is not None and mesh.source != animation.mesh.source:
        animation = animation.on(mesh)
    rig: Any = "pca"
    if arguments.rig == "arkit":
        talker = freetalk.Talker.from_pretrained(find_weights(arguments.pretrained))
        rig = talker.prepare(animation.mesh).blend_shapes(animation)
    report = Report(arguments.quiet)
    for output in outputs:
        write(animation, output, arguments, report, rig)
