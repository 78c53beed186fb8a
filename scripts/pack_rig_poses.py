#!/usr/bin/env python3
"""Chooses the landmark motion that rigs are made of and puts it beside a folder of weights.

    scripts/pack_rig_poses.py --weights python/freetalk/pretrained/open-small

Shapes are the landmark motion of ICT-FaceKit's expressions, merged into ARKit's 51 names. The library holds poses of
speech, sampled by the weights' own ATS under every emotion, and poses of a captured range of motion; poses farthest from
those chosen before come first. All of it is motion of the mean face, in metres, float16.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt
import soundfile as sf
import torch

from freetalk import _native
from freetalk.ats import Ats, GenerateOptions, generate
from freetalk.corpus.assets import load_expression_take, load_face_model, speech_clip
from freetalk.speech import SpeechEncoder, encode_speech

Poses = npt.NDArray[np.float32]

SPEECH_POSES, RANGE_POSES = 90, 30
ROUND = 4  # one pose of the range of motion for so many poses less one of speech
STEP = 2  # every other frame: neighbours are nearly alike
SIDED = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")  # whose side is no mirror image


def ict_names(arkit: str) -> list[str]:
    """ICT-FaceKit's expressions whose sum is an ARKit shape."""
    if arkit in ("browInnerUp", "cheekPuff"):
        return [f"{arkit}_L", f"{arkit}_R"]
    for side in ("Left", "Right"):
        if arkit.endswith(side) and arkit not in SIDED:
            return [f"{arkit[: -len(side)]}_{side[0]}"]
    return [arkit]


def arkit_shapes() -> tuple[list[str], Poses, Poses]:
    """Names, landmark motion (51, 68, 3) of each at weight one, and (T, 68, 3) of the captured range of motion."""
    model = load_face_model()
    weights, captured, _ = load_expression_take()
    columns = [i for i, name in enumerate(captured) if name != "TongueOut"]
    names = [captured[i][0].lower() + captured[i][1:] for i in columns]
    basis = model.landmark_basis
    shapes = np.stack([sum(basis[model.index(part)] for part in ict_names(n)) for n in names])
    motion = np.einsum("tw,wlc->tlc", weights[::STEP, columns], shapes)
    return names, shapes.astype(np.float32), motion.astype(np.float32)


def spoken_poses(weights: Path) -> Poses:
    """(T, 68, 3) motion of one speech under every emotion of the weights, slight and strong."""
    ats, encoder = (
        Ats.from_pretrained(weights / "ats"),
        SpeechEncoder.from_pretrained(weights / "speech"),
    )
    sound, _ = sf.read(speech_clip(), dtype="float32")
    features = encode_speech(encoder, torch.from_numpy(sound), ats.options.fps)
    emotions = torch.eye(len(ats.options.emotions))
    options = GenerateOptions(sampler="dpmpp", num_steps=20)
    motions = [
        generate(ats, features, emotion=emotion, intensity=intensity, options=options).numpy()
        for emotion in emotions
        for intensity in (1.0, float(ats.options.num_intensities))
    ]
    return np.concatenate([motion[::STEP] for motion in motions])


def farthest(poses: Poses, chosen: Poses, count: int) -> Poses:
    """The `count` poses that are farthest, in turn, from those chosen before."""
    points = poses.reshape(len(poses), -1).astype(np.float64)
    distance = np.full(len(points), np.inf)
    for known in chosen.reshape(len(chosen), -1):
        distance = np.minimum(distance, np.square(points - known).sum(1))
    found = []
    for _ in range(count):
        found.append(int(distance.argmax()))
        distance = np.minimum(distance, np.square(points - points[found[-1]]).sum(1))
    return poses[found]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--weights", type=Path, required=True, help="folder with ats/ and speech/")
    arguments = parser.parse_args()
    names, shapes, motion = arkit_shapes()
    known = np.concatenate([np.zeros_like(shapes[:1]), shapes])
    speech = farthest(spoken_poses(arguments.weights), known, SPEECH_POSES)
    wide = farthest(motion, np.concatenate([known, speech]), RANGE_POSES)
    order = np.argsort(  # Any number of leading poses holds both kinds.
        np.concatenate([np.arange(SPEECH_POSES) / (ROUND - 1), np.arange(RANGE_POSES) + 0.99]),
        kind="stable",
    )
    library = np.concatenate([speech, wide])[order]
    tensors = {
        "shapes": torch.from_numpy(shapes).half(),
        "library": torch.from_numpy(library).half(),
    }
    metadata = {
        "format": "freetalk-rig-poses",
        "version": "1",
        "names": "\n".join(names),
        "source": "ICT-FaceKit (MIT), livelinkface_rom (MIT), motion sampled by ATS",
    }
    file = arguments.weights / "rig_poses.safetensors"
    _native.core.save_safetensors(str(file), tensors, metadata)
    print(f"{file}: {len(names)} shapes, {len(library)} poses, {file.stat().st_size} bytes")


if __name__ == "__main__":
    main()
