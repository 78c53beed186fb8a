"""Animates a real face with real English speech in three emotions, with the weights that ship.

    scripts/demo [--out DIR] [--size PIXELS] [--seed N]

Writes face.obj, and for each emotion a .glb with its sound beside it and an .mp4, and contact_sheet.png with all of them.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import freetalk as ft
from freetalk import viz
from freetalk.corpus import assets

PERFORMANCES = (("neutral", 1.0), ("happy", 3.0), ("angry", 3.0))
IDENTITY_SEED = 7
IDENTITY_STRENGTH = 0.5


def main() -> None:
    """Runs the demo."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("demo_out"), help="where to write")
    parser.add_argument("--size", type=int, default=512, help="side of the videos in pixels, even")
    parser.add_argument("--seed", type=int, default=1, help="another seed, another performance")
    parser.add_argument("--pretrained", default="open-small", help="name or folder of the weights")
    arguments = parser.parse_args()
    start = time.perf_counter()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)

    face_file = write_face(out / "face.obj")
    mesh = ft.load_mesh(face_file)
    audio = ft.load_audio(assets.speech_clip())
    talker = ft.Talker.from_pretrained(arguments.pretrained)
    seconds = len(audio.samples) / audio.sample_rate_hz
    print(f"{seconds:.1f} s of speech, a face of {len(mesh.vertices)} vertices: {face_file}")

    animations = []
    for emotion, intensity in PERFORMANCES:
        animations.append(perform(talker, audio, mesh, emotion, intensity, arguments))
    labels = [
        f"{emotion}\n{intensity:g}" if emotion != "neutral" else emotion
        for emotion, intensity in PERFORMANCES
    ]
    sheet = viz.contact_sheet(
        animations, labels, out / "contact_sheet.png", num_columns=9, view=viz.View(zoom=1.2)
    )
    print(f"all of them side by side: {sheet}")
    print(f"done in {time.perf_counter() - start:.1f} s; results are in {out.resolve()}")


def perform(
    talker: ft.Talker,
    audio: ft.Audio,
    mesh: ft.Mesh,
    emotion: str,
    intensity: float,
    arguments: argparse.Namespace,
) -> ft.Animation:
    """One emotion: motion, glTF, video, and how long each took."""
    times = [time.perf_counter()]
    animation = talker.animate(
        audio, mesh, emotion=emotion, intensity=intensity, fps=30, seed=arguments.seed
    )
    times.append(time.perf_counter())
    glb, mp4 = arguments.out / f"{emotion}.glb", arguments.out / f"{emotion}.mp4"
    animation.save(glb)
    times.append(time.perf_counter())
    viz.save_video(animation, mp4, size=(arguments.size, arguments.size))
    times.append(time.perf_counter())
    motion, export, video = np.diff(times)
    print(
        f"{emotion:>8}: motion {motion:.1f} s, {glb} {export:.1f} s, "
        f"{mp4} {video:.1f} s ({animation.num_frames / video:.0f} frames/s)",
        flush=True,
    )
    return animation


def write_face(path: Path) -> Path:
    """Writes a face of ICT-FaceKit with an identity of its own as OBJ, in metres, with quads."""
    model = assets.load_face_model()
    coefficients = IDENTITY_STRENGTH * np.random.default_rng(IDENTITY_SEED).normal(size=100)
    count = assets.EXTENTS["face"]
    shape = np.tensordot(coefficients, model.identity_basis[:, :count], axes=1)
    lines = ["# ICT-FaceKit (MIT, USC ICT), random identity, metres"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in model.neutral[:count] + shape]
    for quad in assets.crop_quads(model, "face"):
        lines.append("f " + " ".join(str(index + 1) for index in quad if index >= 0))
    path.write_text("\n".join(lines) + "\n")
    return path


if __name__ == "__main__":
    main()
