"""Options of ``freetalk speech align`` and ``freetalk speech probe``."""

from __future__ import annotations

import argparse


def add_align(parser: argparse.ArgumentParser) -> None:
    """Options of ``speech align``."""
    parser.description = (
        "Finds when each phone of recorded English is heard, by forced alignment with pocketsphinx. The file it "
        "writes is what 'speech probe', 'evaluate --phones' and task.recordings of a training read."
    )
    parser.add_argument(
        "--transcripts",
        metavar="FILE",
        help="lines RECORDING|TEXT, recordings relative to the file; LJ Speech's metadata.csv too. Without it, words "
        "are recognised in all recordings below --audio",
    )
    parser.add_argument(
        "--audio",
        metavar="DIR",
        help="folder of the recordings, that of the transcripts if left out",
    )
    parser.add_argument(
        "--least-sure",
        type=float,
        default=0.55,
        metavar="P",
        help="recordings in which words are recognised with a lower mean posterior are left out (default: 0.55)",
    )
    parser.add_argument("--out", required=True, metavar="JSON", help="where to write")


def add_probe(parser: argparse.ArgumentParser) -> None:
    """Options of ``speech probe`` except the weights."""
    parser.description = (
        "Fits a linear probe of twelve viseme classes (Jeffers and Barley) on single frames of an encoder's "
        "features, on the corpus's synthetic training speech and on aligned recordings, and scores it on the "
        "corpus's test voices and on further recordings. Writes probe.json and the confusion matrices as "
        "probe.png, with several layers probe_LAYER.png."
    )
    parser.add_argument("--data", required=True, metavar="DIR", help="the open corpus")
    parser.add_argument(
        "--encoder", metavar="DIR", help="another encoder: config.json and model.safetensors"
    )
    parser.add_argument(
        "--fit",
        action="append",
        default=[],
        metavar="JSON",
        help="aligned recordings to fit the probe on as well; repeatable",
    )
    parser.add_argument(
        "--held-out",
        action="append",
        default=[],
        metavar="NAME=JSON",
        help="aligned recordings to score; repeatable",
    )
    parser.add_argument(
        "--layers",
        nargs="+",
        type=int,
        default=[-1],
        metavar="N",
        help="hidden states: -1 the last, 0 what the first layer gets, N what layer N gives",
    )
    parser.add_argument(
        "--sequences", type=int, default=400, help="training sequences to fit on, 0 for all"
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write")
