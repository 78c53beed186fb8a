"""The options of ``freetalk predict`` and ``freetalk evaluate``. Imports nothing heavy."""

from __future__ import annotations

import argparse

from freetalk.cli.motion_options import DEFAULT_WEIGHTS, add_device, add_diffusion
from freetalk.cli.numbers import natural, seed, share

AXES = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
KINDS = ("auto", "vertices", "displacements")


def add_predict(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk predict``."""
    parser.description = (
        "Writes NAME.npz for each clip of a split, or NAME_sampleK.npz of several performances: displacements "
        "(T, V, 3) in metres, which 'freetalk evaluate --pred DIR --gt DATA' scores. A stopped call goes on."
    )
    parser.add_argument(
        "--data", required=True, metavar="[NAME:SPLIT=]DIR", help="a corpus or dataset"
    )
    parser.add_argument("--split", default="test", metavar="SPLIT", help="train, val or test")
    parser.add_argument(
        "--topology", metavar="NAME", help="of a dataset with several: a meshing, or landmarks"
    )
    parser.add_argument(
        "--driver",
        choices=("speech", "landmarks"),
        default="speech",
        help="what moves the faces: the clip's sound, or its recorded landmarks",
    )
    parser.add_argument("--samples", type=natural, default=1, help="performances of each clip")
    parser.add_argument("--seed", type=seed, default=0, help="another seed, other performances")
    add_diffusion(parser)
    batch_help = "clips that are sampled together; by default 16 on a GPU, else one"
    parser.add_argument("--batch", type=natural, default=argparse.SUPPRESS, help=batch_help)
    _add_weights(parser)
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write")


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk evaluate``: which weights or predictions, against what, and how it is told."""
    parser.description = (
        "With --data: measures weights on a dataset's test split. With --pred and --gt: scores folders "
        "of predictions as FaceFormer, CodeTalker, ScanTalk, EmoVOCA and 'freetalk predict' write "
        "them, with intervals and paired tests; the table names units and masks by count and hash."
    )
    parser.add_argument("--data", metavar="[NAME:SPLIT=]DIR", help="a corpus or dataset")
    _add_weights(parser)
    parts = ("stm", "ats", "emotions")
    known = (*parts, "facetalk")
    parts_help = "what; facetalk where the weights hold it"
    parser.add_argument("--parts", nargs="+", choices=known, default=list(parts), help=parts_help)
    take_help = "held-out take; by default the open corpus's captured one, else all of the split"
    parser.add_argument("--take", help=take_help)
    parser.add_argument(
        "--audio", nargs="+", default=[], metavar="FILE", help="more speech, without motion"
    )
    parser.add_argument("--samples", type=natural, default=5, help="performances of the take")
    steps_help = "denoising steps; by default those of the weights"
    parser.add_argument("--steps", type=natural, default=None, help=steps_help)
    out_help = "also write the scores; with --pred by ending: .json, .csv, .tex, .txt; repeatable"
    parser.add_argument("--out", action="append", default=[], metavar="FILE", help=out_help)
    _add_inputs(parser.add_argument_group("predictions of any system (--pred)"))
    _add_reading(parser.add_argument_group("how predictions are read"))
    _add_statistics(parser.add_argument_group("intervals and tests"))


def _add_weights(parser: argparse.ArgumentParser) -> None:
    weights_help = "name of installed weights, or a folder that 'freetalk train --out' wrote"
    parser.add_argument("--pretrained", default=DEFAULT_WEIGHTS, metavar="NAME", help=weights_help)
    add_device(parser)


def _add_inputs(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--pred",
        nargs="+",
        default=[],
        metavar="[NAME=]DIR",
        help="folders of .npy or .npz, a sequence a file: (T, V, 3) or (T, V * 3); several are compared",
    )
    gt_help = "ground truth: such a folder, or a dataset, of which NAME:SPLIT= chooses the splits"
    group.add_argument("--gt", metavar="[NAME:SPLIT=]DIR", help=gt_help)
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
