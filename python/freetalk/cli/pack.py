"""``freetalk models pack``: trained models of several folders as one folder of weights.

A training's own output folder is one already as soon as it has all three.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from freetalk._pretrained import FURTHER_STAGES, STAGES


def add_pack(parser: argparse.ArgumentParser) -> None:
    """Adds the options of ``freetalk models pack``."""
    parser.description = (
        "Puts trained models of several folders together as a folder of weights that --pretrained takes. Weights "
        "that do not say by which commit and from which data they were trained are refused."
    )
    for stage in STAGES:
        parser.add_argument(f"--{stage}", required=True, metavar="DIR", help=f"trained {stage}")
    for stage in FURTHER_STAGES:
        parser.add_argument(f"--{stage}", metavar="DIR", help=f"trained {stage}, if there is one")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to write")
    temperature_help = "of sampling, unless a user gives another; by default 0.3"
    parser.add_argument("--mouth-temperature", type=float, metavar="T", help=temperature_help)
    steps_help = "denoising steps, unless a user gives others; by default 25"
    parser.add_argument("--steps", type=int, metavar="N", help=steps_help)
    gain_help = "gain of the mouth's motion at which it goes as far as recorded mouths do"
    parser.add_argument("--articulation", type=float, default=1.0, metavar="A", help=gain_help)
    codes_help = "the same of FaceTalk's motion"
    parser.add_argument(
        "--code-articulation", type=float, default=1.0, metavar="A", help=codes_help
    )
    parser.add_argument(
        "--untraceable", action="store_true", help="take weights of an unknown commit or data"
    )


def run(arguments: argparse.Namespace) -> None:
    """Checks the stages, copies and completes them.

    Raises:
        ValueError: a stage is missing, does not fit, or does not know where it comes from.
    """
    from freetalk.train.assemble import MOUTH_TEMPERATURE, NUM_STEPS, assemble

    out = Path(arguments.out)
    given = {stage: getattr(arguments, stage) for stage in (*STAGES, *FURTHER_STAGES)}
    folders = {stage: Path(folder) for stage, folder in given.items() if folder is not None}
    for folder in folders.values():
        lacks = untraceable(json.loads((folder / "config.json").read_text()))
        if lacks and not arguments.untraceable:
            raise ValueError(
                f"{folder} does not know its {' and '.join(lacks)}; train it from a git checkout, or pack it with "
                "--untraceable"
            )
    for stage, folder in folders.items():
        (out / stage).mkdir(parents=True, exist_ok=True)
        for file in ("config.json", "model.safetensors"):
            shutil.copyfile(folder / file, out / stage / file)
    _check_codes(out)
    temperature = arguments.mouth_temperature
    lacking = assemble(
        out,
        NUM_STEPS if arguments.steps is None else arguments.steps,
        MOUTH_TEMPERATURE if temperature is None else temperature,
        arguments.articulation,
        arguments.code_articulation,
    )
    if lacking:
        raise ValueError(lacking)
    print(f"weights in {out}")


def _check_codes(out: Path) -> None:
    """Makes sure that codes that are spoken are those of the head beside.

    Raises:
        ValueError: they are of another head.
    """
    speaks, shows = out / "facetalk" / "config.json", out / "head"
    wanted = json.loads(speaks.read_text())["options"].get("head") if speaks.is_file() else None
    if not wanted or not (shows / "config.json").is_file():
        return
    from freetalk.head import ParametricHead, content_hash

    found = content_hash(ParametricHead.from_pretrained(shows).eval())
    if found != wanted:
        raise ValueError(
            f"{out}: facetalk/ speaks codes of the head {wanted}, but head/ is {found}"
        )


def untraceable(config: dict[str, Any]) -> list[str]:
    """What a training's record lacks of the commit and the data that the weights come from."""
    training = config.get("training") or {}
    wanted = {"commit": "unknown", "data_fingerprint": ""}
    return [name for name, none in wanted.items() if training.get(name, none) == none]
