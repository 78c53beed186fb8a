"""The options of ``freetalk evaluate --pred``. Imports nothing heavy."""

from __future__ import annotations

import argparse

AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
KINDS = ("auto", "vertices", "displacements")


def share(text: str) -> float:
    """A number between 0 and 1, both excluded."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is not a number between 0 and 1")
    return value


def add_score_options(parser: argparse.ArgumentParser) -> None:
    """Adds what scores predictions: which, against what, and how the result is written."""
    _add_inputs(parser.add_argument_group("predictions of any system (--pred)"))
    _add_reading(parser.add_argument_group("how predictions are read"))
    _add_statistics(parser.add_argument_group("intervals and tests"))


def _add_inputs(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--pred",
        nargs="+",
        default=[],
        metavar="[NAME=]DIR",
        help="folders of .npy or .npz, a sequence a file: (T, V, 3) or (T, V * 3); several are compared",
    )
    group.add_argument("--gt", metavar="DIR", help="ground truth: such a folder, or a dataset")
    group.add_argument("--split", metavar="SPLIT", help="of a dataset; test if not given")
    group.add_argument(
        "--topology", metavar="NAME", help="of a dataset with several: a meshing, or landmarks"
    )
    group.add_argument(
        "--masks",
        nargs="+",
        default=[],
        metavar="[NAME=]FILE",
        help="vertices of lips and upper face: .npy, .txt, .json, .mat, .pkl; datasets know theirs",
    )
    group.add_argument(
        "--lip-pairs", metavar="FILE", help="(P, 2) vertices of the upper lip and those below them"
    )
    group.add_argument(
        "--templates", metavar="PATH", help="neutral faces: .pkl, .npz, mesh, folder"
    )
    group.add_argument("--wav", metavar="DIR", help="recordings named as the sequences")
    group.add_argument(
        "--phones", metavar="JSON", help="sequence: [[start s, end s, ARPABET label], ...]"
    )
    group.add_argument("--emotions", metavar="JSON", help="sequence: label")
    group.add_argument(
        "--metrics",
        nargs="+",
        default=[],
        metavar="NAME[@MASK]",
        help="which; paper: those of FreeTalk's tables, all: every variant, usual: the usual ones",
    )


def _add_reading(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--unit",
        metavar="UNIT",
        help="of --gt's files where they do not say it: m, cm, mm, in, or metres per unit",
    )
    group.add_argument(
        "--pred-unit",
        metavar="UNIT",
        help="of --pred's, where they do not say it and --gt's is another",
    )
    group.add_argument("--kind", choices=KINDS, default="auto", help="what --gt's folder holds")
    group.add_argument("--pred-kind", choices=KINDS, default="auto", help="what --pred holds")
    group.add_argument(
        "--fps", type=float, help="frames per second of --gt's files where they do not say it"
    )
    group.add_argument(
        "--up",
        choices=tuple(AXES),
        help="axis to the top of the head; as --gt's files say, else +y",
    )
    group.add_argument(
        "--names",
        metavar="PATTERN",
        help="file names, such as 'mymodel_{name}_take{sample}'; NAME and NAME_condition_STYLE are known",
    )
    group.add_argument(
        "--strict",
        action="store_true",
        help="no missing or unknown sequence, no differing length (else the shorter counts, up to a tenth)",
    )


def _add_statistics(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--baseline", metavar="NAME", help="compare with it; by default the first")
    group.add_argument("--confidence", type=share, default=0.95, help="of the intervals")
    group.add_argument(
        "--resamples", type=int, default=10000, metavar="N", help="of bootstrap and permutation"
    )
    group.add_argument(
        "--score-seed", type=int, default=0, metavar="N", help="same seed, same intervals"
    )
