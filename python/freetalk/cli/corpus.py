"""``freetalk corpus``."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from freetalk.cli.outputs import check_readable, check_writable


def build(arguments: argparse.Namespace) -> None:
    """Builds the open corpus."""
    check_writable(Path(arguments.out), is_folder=True)
    from freetalk.corpus import build_corpus

    start = time.perf_counter()
    folder = build_corpus(Path(arguments.out), size=arguments.size, seed=arguments.seed)
    print(f"corpus ({arguments.size}) in {folder}, {time.perf_counter() - start:.1f} s")


def heads(arguments: argparse.Namespace) -> None:
    """Writes watertight heads."""
    check_writable(Path(arguments.out), is_folder=True)
    from freetalk.corpus.heads import write_heads

    expression = {}
    for given in arguments.expression:
        name, _, value = given.partition("=")
        try:
            expression[name] = float(value)
        except ValueError:
            raise ValueError(f"--expression {given} is not understood: write NAME=WEIGHT") from None
    paths = write_heads(
        Path(arguments.out),
        count=arguments.count,
        held_out=arguments.held_out,
        expression=expression,
        seed=arguments.seed,
    )
    print(f"{len(paths)} heads in {arguments.out}")


def codes(arguments: argparse.Namespace) -> None:
    """Writes codes into a corpus."""
    check_readable(str(Path(arguments.head) / "config.json"), "a head's configuration")
    check_readable(str(Path(arguments.data) / "manifest.json"), "the manifest of a packed corpus")
    from freetalk.corpus.codes import CAPTURED, make_codes
    from freetalk.head import ParametricHead

    head = ParametricHead.from_pretrained(arguments.head).eval()
    done = make_codes(head, arguments.data, fitted=() if arguments.no_fit else CAPTURED)
    print(f"codes of {done.frames} frames in {arguments.data}")
    if done.fitted:
        print(
            f"{done.fitted} captured frames: {done.rig_mm:.2f} mm from the posed face by the codes of their weights, "
            f"{done.fitted_mm:.2f} mm fitted"
        )
