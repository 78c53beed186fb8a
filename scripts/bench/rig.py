#!/usr/bin/env python3
"""Decoding few frames, and the rig, against decoding every frame: meshes x emotions x voices.

    python scripts/bench/rig.py                            # the packaged faces and voices
    python scripts/bench/rig.py --data DIR --seconds 10    # also the heads and recordings found there

DIR may hold mhr_head/mhr_head.obj, mediapipe_canonical/canonical_face_model.obj, speech_english/LJ001-0001.wav and
facegood_audio2face/unpaired/1114_3_07.wav; what is absent is named and passed over. A line gives the frames decoded,
the adaptive error (mean as a share of the mean motion, largest) and the rig's error (mean, 99th percentile, largest).
Run it on an idle machine for the times.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile as sf
import torch
from scipy.signal import resample_poly

import freetalk
from freetalk.ats import Ats, GenerateOptions, generate
from freetalk.corpus.assets import load_clips, load_face_model
from freetalk.corpus.topologies import TOPOLOGIES
from freetalk.geometry import align_to_template, surface_operators
from freetalk.mesh import connected_components, load_mesh
from freetalk.rig import FaceRig
from freetalk.speech import SpeechEncoder, encode_speech
from freetalk.stm import FrameDecoder, Stm, decode_adaptively

WEIGHTS = Path(freetalk.__file__).parent / "pretrained" / "open-small"
EMOTIONS = (("neutral", 1.0), ("happy", 3.0), ("angry", 3.0))
FACES = ("face", "narrow", "face_iso5000", "sockets_dec5000", "head_holes4000")
HEADS = ("mhr_head/mhr_head.obj", "mediapipe_canonical/canonical_face_model.obj")
RECORDINGS = {
    "lj": "speech_english/LJ001-0001.wav",
    "facegood": "facegood_audio2face/unpaired/1114_3_07.wav",
}
RATE = 16000


@dataclass
class Row:
    """Errors in millimetres but for `adaptive_mean`, a share of the mean motion."""

    decoded: int
    adaptive_mean: float
    adaptive_max: float
    rig_mean: float
    rig_p99: float
    rig_max: float
    solve_ms: float  # a frame


def voices(data: Path | None, seconds: float) -> Iterator[tuple[str, torch.Tensor]]:
    """Name and samples at 16 kHz."""
    clips = [clip.audio for clip in load_clips() if clip.speaker == "09"]
    yield "emodb", torch.from_numpy(np.concatenate(clips)[: int(seconds * RATE)])
    for name, file in RECORDINGS.items():
        path = (data or Path()) / file
        if data is None or not path.is_file():
            print(f"voice {name}: no {path}, passed over")
            continue
        sound, rate = sf.read(path, dtype="float32", frames=int(seconds * sf.info(path).samplerate))
        sound = sound if sound.ndim == 1 else sound.mean(1)
        yield name, torch.from_numpy(resample_poly(sound, RATE, rate).astype(np.float32))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "espeak.wav"
        text = (
            "The birch canoe slid on the smooth planks. Glue the sheet to the dark blue background."
        )
        try:
            subprocess.run(["espeak-ng", "-w", file, text], check=True)
        except FileNotFoundError:
            print("voice espeak: no espeak-ng, passed over")
            return
        sound, rate = sf.read(file, dtype="float32")
        yield "espeak", torch.from_numpy(resample_poly(sound, RATE, rate).astype(np.float32))


def meshes(data: Path | None) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, vertices in metres in the canonical frame, faces."""
    model = load_face_model()
    for spec in (one for one in TOPOLOGIES if one.name in FACES):
        meshing = spec.build(model)
        yield spec.name, meshing.carry @ model.neutral.astype(np.float64), meshing.faces
    template = freetalk._native.core.load_safetensors(str(WEIGHTS / "template.safetensors"))
    for file in HEADS:
        path = (data or Path()) / file
        if data is None or not path.is_file():
            print(f"mesh {path.stem}: no {path}, passed over")
            continue
        mesh = load_mesh(path)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        pose = align_to_template(
            vertices, faces, template["points"].double(), template["normals"].double()
        ).to_canonical
        component = connected_components(len(vertices), faces)  # the skin; the rest is no STM's
        keep = component == np.bincount(component).argmax()
        number = np.cumsum(keep) - 1
        yield path.stem, pose.apply(vertices)[keep], number[faces[keep[faces].all(1)]]


def measure(decoder: FrameDecoder, rig: FaceRig, landmarks: torch.Tensor) -> Row:
    exact = decoder.decode(landmarks)
    few, report = decode_adaptively(decoder, landmarks)
    error = (few - exact).norm(dim=-1)
    start = time.perf_counter()
    played = rig.vertices(rig.solve(landmarks))
    seconds = time.perf_counter() - start
    left = 1e3 * (played - exact).norm(dim=-1)
    return Row(
        decoded=report.decoded,
        adaptive_mean=float(error.mean() / exact.norm(dim=-1).mean()),
        adaptive_max=1e3 * float(error.max()),
        rig_mean=float(left.mean()),
        rig_p99=float(np.quantile(left.numpy(), 0.99)),
        rig_max=float(left.max()),
        solve_ms=1e3 * seconds / len(landmarks),
    )


def motions(data: Path | None, seconds: float) -> dict[str, torch.Tensor]:
    """(T, 68, 3) of every voice under every emotion."""
    ats, encoder = (
        Ats.from_pretrained(WEIGHTS / "ats"),
        SpeechEncoder.from_pretrained(WEIGHTS / "speech"),
    )
    options = GenerateOptions(num_steps=25, mouth_temperature=0.3)
    names = ats.options.emotions
    made = {}
    for voice, samples in voices(data, seconds):
        features = encode_speech(encoder, samples, ats.options.fps)
        for emotion, intensity in EMOTIONS:
            mixture = torch.eye(len(names))[names.index(emotion)]
            made[f"{voice} {emotion} {intensity:.0f}"] = generate(
                ats, features, emotion=mixture, intensity=intensity, options=options
            )
    return made


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--data", type=Path, help="folder of further heads and recordings")
    parser.add_argument("--seconds", type=float, default=6.0, help="of each voice")
    parser.add_argument("--meshes", nargs="*", help="only these")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    stm = Stm.from_pretrained(WEIGHTS / "stm").eval()
    clips = motions(arguments.data, arguments.seconds)
    rows: list[Row] = []
    for name, vertices, faces in meshes(arguments.data):
        if arguments.meshes and name not in arguments.meshes:
            continue
        o = stm.options
        operators = surface_operators(vertices / o.length_scale, faces, k=o.k_eig).to(
            dtype=torch.float32
        )
        with torch.no_grad():
            features = stm.encode(torch.from_numpy(vertices).float(), operators)
        decoder = stm.frame_decoder(features, operators)
        start = time.perf_counter()
        rig = FaceRig.build(decoder.decode, WEIGHTS / "rig_poses.safetensors")
        print(f"{name}: {len(vertices)} vertices, rig of {len(rig.names)} targets in "
              f"{time.perf_counter() - start:.1f} s")  # fmt: skip
        for clip, landmarks in clips.items():
            row = measure(decoder, rig, landmarks)
            rows.append(row)
            print(f"  {clip:18} {row.decoded:4}/{len(landmarks)} decoded {100 * row.adaptive_mean:5.2f} % "
                  f"{row.adaptive_max:5.2f} mm | rig {row.rig_mean:5.3f} {row.rig_p99:5.2f} "
                  f"{row.rig_max:5.2f} mm, {row.solve_ms:.2f} ms a frame", flush=True)  # fmt: skip
    for label, pick in (("median", np.median), ("worst", np.max)):
        values = {field: pick([getattr(row, field) for row in rows]) for field in vars(rows[0])}
        print(f"{label:7}" + ", ".join(f"{field} {value:.4g}" for field, value in values.items()))


if __name__ == "__main__":
    main()
