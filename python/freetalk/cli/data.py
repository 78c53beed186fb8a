"""``freetalk data`` and ``freetalk corpus``."""

from __future__ import annotations

import argparse
import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from freetalk._files import write_json
from freetalk.cli.outputs import check_readable, check_writable

_SHOWN = 20


def import_release(arguments: argparse.Namespace) -> None:
    """Packs a release and tells what it is and what was left out."""
    from tqdm import tqdm

    from freetalk.data import check_dataset, import_dataset

    out = import_dataset(
        arguments.name,
        arguments.source,
        arguments.out,
        name=arguments.called,
        fps=arguments.fps,
        unit=arguments.unit,
        progress=partial(tqdm, desc="packing", unit="take", leave=False),
    )
    _print_report(check_dataset(out, quick=True))
    print(f"packed in {out}")


def check(arguments: argparse.Namespace) -> None:
    """Tells what a dataset is, and what is missing or wrong with it.

    Raises:
        ValueError: there are errors; the message counts them, they are printed before.
    """
    if arguments.json is not None:
        check_writable(Path(arguments.json))
    from tqdm import tqdm

    from freetalk.data import check_dataset, parse_spec

    name, split, path = parse_spec(arguments.data)
    report = check_dataset(
        path,
        name=name,
        split=split,
        unit=arguments.unit,
        kind=arguments.kind,
        quick=arguments.quick,
        progress=partial(tqdm, desc="reading", unit="take", leave=False),
    )
    _print_report(report)
    if arguments.json is not None:
        write_json(Path(arguments.json), vars(report))
    if not report.ok:
        count = len(report.errors)
        raise ValueError(f"{path} has {count} error{'s' if count > 1 else ''}, listed above")
    packed = (Path(path) / "manifest.json").is_file()
    note = " (motion and sound were not read)" if arguments.quick else ""
    print(("ready to train" if packed else "ready for 'freetalk data import'") + note)


def _print_report(report: Any) -> None:
    for line in _lines(report.facts):
        print(line)
    _print_list("left out", [f"{name}: {reason}" for name, reason in report.excluded.items()])
    _print_list("warning", report.warnings)
    _print_list("error", report.errors)


def from_video(arguments: argparse.Namespace) -> None:
    """Makes a dataset of videos of talking faces, or of face points tracked in them."""
    check_writable(Path(arguments.out))
    from tqdm import tqdm

    from freetalk.video import fit_talker, save_fit_picture, tracks_by_talker, write_dataset

    tracks = tracks_by_talker([Path(source) for source in arguments.sources], arguments.talkers)
    talkers = [fit_talker(clips) for clips in tqdm(tracks.values(), "talkers")]
    report = write_dataset(Path(arguments.out), talkers, arguments.split)
    for talker in talkers:
        with suppress(RuntimeError):  # without matplotlib there is no picture
            save_fit_picture(talker, Path(arguments.out) / "fit" / f"{talker.name}.png")
    for name, own in report["talkers"].items():
        print(
            f"{name}: {own['clips']} clips, {own['frames']} frames; points {own['error_px']:.2f} px off, opening "
            f"r {own['opening_correlation']:.3f}, width r {own['width_correlation']:.3f}, "
            f"{own['closed']:.0%} of closed lips closed"
        )
    _print_list("left out", [f"{name}: {why}" for name, why in report["left_out"].items()])
    splits = ", ".join(f"{count} {split}" for split, count in report["splits"].items())
    print(f"{splits}; train on it with 'freetalk train ats --data {arguments.out}'")


def _print_list(kind: str, messages: list[str]) -> None:
    for message in messages[:_SHOWN]:
        print(f"{kind}: {message}")
    if len(messages) > _SHOWN:
        print(f"... and {len(messages) - _SHOWN} more ({kind}; data check --json FILE has all)")


def _lines(facts: dict[str, Any]) -> list[str]:
    """Facts as text, one a line; a list of vertices by count and hash."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, dict) and "sha256" in value:
            source = f" from {value['source']}" if "source" in value else ""
            known = f", {value['known_as']}" if value.get("known_as") else ""
            value = f"{value['count']} ({value['sha256']}){source}{known}"
        elif isinstance(value, dict):
            value = ", ".join(f"{k} {v}" for k, v in value.items())
        elif isinstance(value, list):
            value = " ".join(map(str, value))
        lines.append(f"  {key.replace('_', ' ')}: {value}")
    return lines


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
