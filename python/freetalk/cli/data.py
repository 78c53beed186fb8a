"""``freetalk data``."""

from __future__ import annotations

import argparse
import json
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from freetalk.cli.outputs import check_writable

_SHOWN = 20


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
    for line in _lines(report.facts):
        print(line)
    _print_list("warning", report.warnings)
    _print_list("error", report.errors)
    if arguments.json is not None:
        content = {"facts": report.facts, "warnings": report.warnings, "errors": report.errors}
        Path(arguments.json).write_text(json.dumps(content, indent=2) + "\n")
    if not report.ok:
        count = len(report.errors)
        raise ValueError(f"{path} has {count} error{'s' if count > 1 else ''}, listed above")
    print("ready to train" + (" (motion and sound were not read)" if arguments.quick else ""))


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
        print(f"... and {len(messages) - _SHOWN} more {kind}s (--json FILE has all)")


def _lines(facts: dict[str, Any]) -> list[str]:
    """Facts as text, one a line; a list of vertices by count and hash."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, dict) and "sha256" in value:
            source = f" from {value['source']}" if "source" in value else ""
            known = f", {value['known_as']}" if value.get("known_as") else ""
            value = f"{value['count']} ({value['sha256']}){source}{known}"
        elif isinstance(value, dict) and any(isinstance(v, dict) for v in value.values()):
            value = f"{len(value)}: {', '.join(map(str, value))}"
        elif isinstance(value, dict):
            value = ", ".join(f"{k} {v}" for k, v in value.items())
        elif isinstance(value, list):
            value = " ".join(map(str, value))
        lines.append(f"  {key.replace('_', ' ')}: {value}")
    return lines
