#!/usr/bin/env python3
"""Decoding few frames, and the rig of live speech, against decoding every frame: meshes x emotions x voices.

    python scripts/bench/rig.py                            # the packaged faces and voices
    python scripts/bench/rig.py --data DIR --seconds 10    # also the heads and recordings found there

DIR may hold mhr_head/mhr_head.obj, mediapipe_canonical/canonical_face_model.obj, speech_english/LJ001-0001.wav and
facegood_audio2face/unpaired/1114_3_07.wav; what is absent is named and passed over. A line gives the frames decoded,
the adaptive error (mean as a share of the mean motion, largest) and, over the frames of a stream, what the rig shows
against what the network does (mean, 99th percentile, largest).
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
from typing import Any

import numpy as np
import soundfile as sf
import torch

import freetalk
from freetalk.corpus.assets import load_clips, load_face_model
from freetalk.corpus.topologies import TOPOLOGIES

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
    frames: int
    adaptive_mean: float
    adaptive_max: float
    rig_mean: float
    rig_p99: float
    rig_max: float
    decode_ms: float  # a frame, by the rig


def voices(data: Path | None, seconds: float) -> Iterator[tuple[str, freetalk.Audio]]:
    """Name and speech."""
    clips = [clip.audio for clip in load_clips() if clip.speaker == "09"]
    yield "emodb", freetalk.Audio(np.concatenate(clips)[: int(seconds * RATE)], RATE)
    for name, file in RECORDINGS.items():
        path = (data or Path()) / file
        if data is None or not path.is_file():
            print(f"voice {name}: no {path}, passed over")
            continue
        sound, rate = sf.read(path, dtype="float32", frames=int(seconds * sf.info(path).samplerate))
        sound = sound if sound.ndim == 1 else sound.mean(1)
        yield name, freetalk.Audio(sound, rate)
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
        yield "espeak", freetalk.Audio(sound, rate)


def meshes(data: Path | None) -> Iterator[tuple[str, freetalk.Mesh]]:
    """Name and mesh."""
    model = load_face_model()
    for spec in (one for one in TOPOLOGIES if one.name in FACES):
        meshing = spec.build(model)
        vertices = meshing.carry @ model.neutral.astype(np.float64)
        yield spec.name, freetalk.Mesh(vertices, meshing.faces.tolist(), name=spec.name)
    for file in HEADS:
        path = (data or Path()) / file
        if data is None or not path.is_file():
            print(f"mesh {path.stem}: no {path}, passed over")
            continue
        yield path.stem, freetalk.load_mesh(path)


def live_vertices(
    face: freetalk.Face, audio: freetalk.Audio, emotion: str, intensity: float, rig: bool
) -> tuple[np.ndarray, float]:
    """(T, V, 3) of a stream by the rig or by the network, and the seconds that decoding took."""
    live = face.live(emotion=emotion, intensity=intensity, blinks=False, rig=rig)
    frames = live.push(audio.samples) + live.finish()
    start = time.perf_counter()
    vertices = np.stack([np.asarray(live.decode(frame)) for frame in frames])
    return vertices, time.perf_counter() - start


def measure(face: freetalk.Face, audio: freetalk.Audio, emotion: str, intensity: float) -> Row:
    def played(tolerance_mm: float) -> tuple[torch.Tensor, Any]:
        animation, report = face.animate_with_report(
            audio,
            emotion=emotion,
            intensity=intensity,
            blinks=False,
            tolerance_mm=tolerance_mm,
            progress=False,
        )
        return animation.displacements, report

    exact, _ = played(0)
    few, report = played(0.2)
    error = (few - exact).norm(dim=-1)
    by_rig, seconds = live_vertices(face, audio, emotion, intensity, rig=True)
    by_network, _ = live_vertices(face, audio, emotion, intensity, rig=False)
    left = 1e3 * np.linalg.norm(by_rig - by_network, axis=-1)
    return Row(
        decoded=report.decoded_frames,
        frames=len(exact),
        adaptive_mean=float(error.mean() / exact.norm(dim=-1).mean()),
        adaptive_max=1e3 * float(error.max()),
        rig_mean=float(left.mean()),
        rig_p99=float(np.quantile(left, 0.99)),
        rig_max=float(left.max()),
        decode_ms=1e3 * seconds / len(by_rig),
    )


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
    talker = freetalk.Talker.from_pretrained(WEIGHTS, device="cpu")
    sounds = dict(voices(arguments.data, arguments.seconds))
    rows: list[Row] = []
    for name, mesh in meshes(arguments.data):
        if arguments.meshes and name not in arguments.meshes:
            continue
        face = talker.prepare(mesh, cache_dir=None, progress=False)
        start = time.perf_counter()
        rig = face.rig()
        seconds = time.perf_counter() - start
        print(
            f"{name}: {len(mesh.vertices)} vertices, rig of {len(rig.names)} targets in {seconds:.1f} s"
        )
        for voice, audio in sounds.items():
            for emotion, intensity in EMOTIONS:
                row = measure(face, audio, emotion, intensity)
                rows.append(row)
                print(
                    f"  {voice:9} {emotion:8} {row.decoded:4}/{row.frames} decoded {100 * row.adaptive_mean:5.2f} % "
                    f"{row.adaptive_max:5.2f} mm | rig {row.rig_mean:5.3f} {row.rig_p99:5.2f} "
                    f"{row.rig_max:5.2f} mm, {row.decode_ms:.2f} ms a frame",
                    flush=True,
                )
    for label, pick in (("median", np.median), ("worst", np.max)):
        values = {field: pick([getattr(row, field) for row in rows]) for field in vars(rows[0])}
        print(f"{label:7}" + ", ".join(f"{field} {value:.4g}" for field, value in values.items()))


if __name__ == "__main__":
    main()
