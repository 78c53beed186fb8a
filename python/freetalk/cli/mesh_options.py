"""Options of ``freetalk mesh`` and of commands that are told where a face is."""

from __future__ import annotations

import argparse
from typing import Any


def add_landmarks(parser: argparse.ArgumentParser) -> None:
    """Adds those of ``freetalk mesh landmarks``."""
    parser.description = (
        "Finds the face on a mesh of any meshing, unit and pose, a whole character too, and writes where "
        "its 68 landmarks (iBUG order) lie, with confidences, as JSON for 'freetalk animate --landmarks' "
        "and for datasets of that template. Pictures of the mesh are looked at (extra 'faces'), then the "
        "built-in face is fitted; without them, its shape alone counts. Look at the picture, then "
        "correct: --start FILE --set 48=1532."
    )
    parser.add_argument("file", metavar="FILE", help="OBJ, PLY, OFF, STL or glTF")
    parser.add_argument("--out", default="landmarks68.json", metavar="JSON", help="where to write")
    parser.add_argument("--picture", metavar="PNG", help="also draw them with their numbers")
    parser.add_argument(
        "--masks", action="store_true", help="also write lip_mask.json and upper_mask.json beside"
    )
    parser.add_argument(
        "--pictures",
        choices=("auto", "yes", "no"),
        default="auto",
        help="look at pictures of the mesh; auto: where the extra is installed",
    )
    parser.add_argument(
        "--start", metavar="FILE", help="landmarks to correct instead of those found"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="N=VERTEX", help="correct one; repeatable"
    )


def add_prepare(parser: argparse.ArgumentParser) -> None:
    """Adds those of ``freetalk mesh prepare``."""
    parser.description = (
        "Repairs a scan before it speaks and says what was done: duplicate polygons and floating bits go, "
        "polygons are turned outward, holes of a chosen size are closed, lips that are one closed skin are cut apart "
        "and an inner mouth is sewn behind them. Texture coordinates, materials and colours are kept."
    )
    parser.add_argument("file", metavar="FILE", help="OBJ, PLY, OFF, STL or glTF")
    parser.add_argument("--out", required=True, metavar="FILE", help="OBJ, PLY or glTF to write")
    parser.add_argument("--map", metavar="NPY", help="also write the new vertex of each old one")
    parser.add_argument(
        "--floating",
        type=float,
        default=0.002,
        metavar="SHARE",
        help="drop parts with less than this share of the polygons; 0 keeps all",
    )
    parser.add_argument(
        "--holes",
        type=int,
        default=0,
        metavar="N",
        help="close holes of at most N edges (eyes, mouth and neck are holes too)",
    )
    parser.add_argument(
        "--vertices",
        type=int,
        metavar="N",
        help="thin the mesh out or refine it to about N vertices, most of them around mouth and eyes",
    )
    for name, what in (("duplicates", "duplicate polygons"), ("winding", "the winding")):
        parser.add_argument(f"--keep-{name}", action="store_true", help=f"leave {what} alone")
    parser.add_argument(
        "--keep-lips", action="store_true", help="leave lips alone that are one closed skin"
    )
    parser.add_argument(
        "--no-inner-mouth", action="store_true", help="cut a slit, but sew nothing behind it"
    )
    parser.add_argument(
        "--parts",
        action="store_true",
        help="put teeth, gums and a tongue behind open lips and eyeballs behind open lids",
    )
    parser.add_argument(
        "--landmarks",
        metavar="FILE",
        help="where the face is, as 'freetalk mesh landmarks' writes it; by default it is looked for",
    )


def add_where(parser: argparse.ArgumentParser) -> None:
    """Adds what tells where the face of a mesh is."""
    parser.add_argument(
        "--landmarks",
        metavar="FILE",
        help="where the face is: its 68 landmarks, as 'freetalk mesh landmarks' writes them",
    )
    parser.add_argument(
        "--follow-landmarks",
        choices=("auto", "yes", "no"),
        default="auto",
        help="whether the surface is made to follow the motion of the landmarks; auto: as the weights say",
    )


def preparation(arguments: argparse.Namespace) -> dict[str, Any]:
    """What was given of how a face is prepared, by the names of the library's options."""
    names = ("unit", "up", "forward", "engine", "precision", "follow_landmarks")
    given = vars(arguments)
    return {name: given[name] for name in names if name in given}
