"""Puts trained models together as a folder of weights that `freetalk.Talker` loads.

    .venv/bin/python scripts/pack_weights.py --speech runs/speech --ats runs/ats --stm runs/stm --out weights/mine

Each of the three is a folder that `freetalk train` exported (config.json and model.safetensors). The face template, to
which every mesh is aligned, is sampled from the mean face of the packaged face model. Weights that do not say by which
commit and from which data they were trained are refused: what ships must be traceable (--untraceable lets them pass).
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freetalk import _native
from freetalk.ats import Ats
from freetalk.corpus import load_face_model, mean_face
from freetalk.geometry import sample_template
from freetalk.speech import SpeechEncoder
from freetalk.stm import Stm

TEMPLATE_POINTS = 2500


def write_template(path: Path) -> None:
    """Points, normals and landmarks of the mean face, metres, canonical frame."""
    points, normals = sample_template(*mean_face("face"), TEMPLATE_POINTS)
    model = load_face_model()
    tensors = {
        "points": torch.from_numpy(np.asarray(points, dtype=np.float32)),
        "normals": torch.from_numpy(np.asarray(normals, dtype=np.float32)),
        "landmarks68": torch.from_numpy(
            np.asarray(model.neutral[model.landmarks68], dtype=np.float32)
        ),
    }
    _native.core.save_safetensors(str(path), tensors, {"source": "ICT-FaceKit mean face, MIT"})


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
        default=0.3,
        help="of sampling, unless a user gives another",
    )
    parser.add_argument(
        "--steps", type=int, default=25, help="denoising steps, unless a user gives others"
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
    SpeechEncoder.from_pretrained(arguments.speech)
    ats = Ats.from_pretrained(arguments.ats)
    Stm.from_pretrained(arguments.stm)
    for name in ("speech", "ats", "stm"):
        source, target = getattr(arguments, name), arguments.out / name
        target.mkdir(parents=True, exist_ok=True)
        for file in ("config.json", "model.safetensors"):
            shutil.copyfile(source / file, target / file)
    write_template(arguments.out / "template.safetensors")
    description = {
        "format": "freetalk-talker",
        "version": 1,
        "fps": ats.options.fps,
        "sample_rate_hz": 16000,
        "emotions": list(ats.options.emotions),
        "generate": {
            "num_steps": arguments.steps,
            "mouth_temperature": arguments.mouth_temperature,
        },
    }
    (arguments.out / "talker.json").write_text(json.dumps(description, indent=2) + "\n")
    print(f"weights in {arguments.out}")


if __name__ == "__main__":
    main()
