"""Puts trained models of several folders together as a folder of weights that `freetalk.Talker` loads.

    .venv/bin/python scripts/pack_weights.py --speech runs/a/speech --ats runs/b/ats --stm runs/c/stm --out weights/mine

A training's own output folder is one already as soon as it has all three. Weights that do not say by which commit and
from which data they were trained are refused: what ships must be traceable (--untraceable lets them pass).
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

from freetalk.train.assemble import MOUTH_TEMPERATURE, NUM_STEPS, assemble


def untraceable(config: dict[str, Any]) -> list[str]:
    """What a training's record lacks of the commit and the data that the weights come from."""
    training = config.get("training") or {}
    wanted = {"commit": "unknown", "data_fingerprint": ""}
    return [name for name, none in wanted.items() if training.get(name, none) == none]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    for name in ("speech", "ats", "stm"):
        parser.add_argument(f"--{name}", type=Path, required=True, help=f"exported {name} folder")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument(
        "--mouth-temperature",
        type=float,
        default=MOUTH_TEMPERATURE,
        help="of sampling, unless a user gives another",
    )
    parser.add_argument(
        "--steps", type=int, default=NUM_STEPS, help="denoising steps, unless a user gives others"
    )
    parser.add_argument(
        "--untraceable",
        action="store_true",
        help="pack weights of an unknown commit or unknown data",
    )
    arguments = parser.parse_args()
    for name in ("speech", "ats", "stm"):
        lacks = untraceable(json.loads((getattr(arguments, name) / "config.json").read_text()))
        if lacks and not arguments.untraceable:
            parser.error(
                f"{getattr(arguments, name)} does not know its {' and '.join(lacks)}; train it from a "
                "git checkout, or pack it with --untraceable"
            )
    for name in ("speech", "ats", "stm"):
        source, target = getattr(arguments, name), arguments.out / name
        target.mkdir(parents=True, exist_ok=True)
        for file in ("config.json", "model.safetensors"):
            shutil.copyfile(source / file, target / file)
    lacking = assemble(arguments.out, arguments.steps, arguments.mouth_temperature)
    if lacking:
        parser.error(lacking)
    print(f"weights in {arguments.out}")


if __name__ == "__main__":
    main()
