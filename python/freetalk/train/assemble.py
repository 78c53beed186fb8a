"""From the stages of a training's output folder to weights that ``freetalk animate --pretrained`` takes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import torch

from freetalk import _native
from freetalk._files import content_hash, replacing, write_json
from freetalk._pretrained import missing_stages

#: Of sampling, unless a user gives others.
NUM_STEPS, MOUTH_TEMPERATURE = 25, 0.3
_TEMPLATE_POINTS = 2500


def assemble(
    out: Path,
    num_steps: int = NUM_STEPS,
    mouth_temperature: float = MOUTH_TEMPERATURE,
    articulation: float = 1.0,
    code_articulation: float = 1.0,
) -> str:
    """Makes an output folder with all stages a folder of weights.

    The speech encoder that an audio stage was trained with is copied into it, where there is none.

    Args:
        out: output folder of trainings.
        num_steps: denoising steps, unless a user gives others.
        mouth_temperature: of sampling, likewise, and FaceTalk's.
        articulation: gain of the mouth's motion at which it goes as far as recorded mouths do.
        code_articulation: the same of FaceTalk's motion.

    Returns:
        One sentence on what the folder still lacks; empty where it is complete.
    """
    heard = _heard_encoder(out, "ats") or _heard_encoder(out, "facetalk")
    if heard and "speech" in missing_stages(out) and encoder_hash(Path(heard["folder"])):
        for name in ("model.safetensors", "config.json"):
            with replacing(out / "speech" / name) as temporary:
                shutil.copyfile(Path(heard["folder"]) / name, temporary)
    lacking = missing_stages(out)
    if lacking:
        commands = " and ".join(f"`freetalk train {stage} --out {out}`" for stage in lacking)
        return f"{out} lacks {' and '.join(lacking)} for `freetalk animate --pretrained`: run {commands}"
    for stage in ("ats", "facetalk"):
        heard = _heard_encoder(out, stage)
        if heard and heard["hash"] != encoder_hash(out / "speech"):
            (out / "talker.json").unlink(missing_ok=True)
            return (
                f"{out / stage} was trained with the speech encoder in {heard['folder']}, not with the one in "
                f"{out / 'speech'}: put that one there, or train the audio stage again"
            )
    options = json.loads((out / "ats" / "config.json").read_text())["options"]
    _write_template(out / "template.safetensors")
    about = {
        "format": "freetalk-talker",
        "version": 1,
        "fps": options["fps"],
        "sample_rate_hz": 16000,
        "emotions": options["emotions"],
        "generate": {
            "num_steps": num_steps,
            "mouth_temperature": mouth_temperature,
            "articulation": articulation,
        },
    }
    if (out / "facetalk" / "config.json").is_file():
        about["facetalk"] = {
            "temperature": mouth_temperature,
            "articulation": code_articulation,
        }
    write_json(out / "talker.json", about)
    return ""


def encoder_record(folder: Path) -> dict[str, str]:
    """What the audio stage notes of the speech encoder that it was trained with."""
    return {"folder": str(folder), "hash": encoder_hash(folder)}


def encoder_hash(folder: Path) -> str:
    """Hash of a speech encoder's weights; empty where there are none."""
    weights = folder / "model.safetensors"
    return content_hash(weights) if weights.is_file() else ""


def _heard_encoder(out: Path, stage: str) -> dict[str, str]:
    """What an audio stage noted, see :func:`encoder_record`; empty where there is no such stage."""
    config = out / stage / "config.json"
    if not config.is_file():
        return {}
    return dict(json.loads(config.read_text()).get("training", {}).get("speech_encoder") or {})


def _write_template(path: Path) -> None:
    """Points, normals and landmarks of the mean face, to which meshes are aligned; metres, canonical frame."""
    from freetalk.corpus import mean_face  # which need seconds to import
    from freetalk.corpus.linear_face import built_in_face
    from freetalk.geometry import sample_template
    from freetalk.mesh import vertex_normals

    points, normals = sample_template(*mean_face("face"), _TEMPLATE_POINTS)
    face = built_in_face()
    arrays = {
        "points": points,
        "normals": normals,
        "landmarks68": face.neutral[face.landmarks],
        "outward68": vertex_normals(face.neutral, face.faces)[face.landmarks],
    }
    tensors = {n: torch.from_numpy(np.asarray(a, dtype=np.float32)) for n, a in arrays.items()}
    _native.core.save_safetensors(str(path), tensors, {"source": "ICT-FaceKit mean face, MIT"})
