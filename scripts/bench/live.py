#!/usr/bin/env python3
"""Live speech against the offline result: how fast, how late, how close, how smooth.

    python scripts/bench/live.py [--seconds 12] [--threads 2] [--emotion happy] [--hop 0.12] [--vertices]
    python scripts/bench/live.py --memory 10   # minutes of one stream: resident memory after one and all

Clips are the recordings that ship (English, Mandarin, seven German speakers). Offline is the motion that the
weights' own sampler makes of the whole clip with the same seed. A row a clip, then medians and worst cases:
real-time factor of push(), latency (promised, and the worst seen when the clip is played in its own time),
correlation of inner-lip opening, mean distance of mouth landmarks, jerk (third difference) of the mouth across
seams against elsewhere, for both.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

import freetalk
from freetalk._pretrained import PRETRAINED
from freetalk.corpus import assets
from freetalk.evaluate.pretrained import SpeechToMotion

WEIGHTS = PRETRAINED / "open-small"
RATE_HZ = 16000
INNER_LIPS = ((61, 67), (62, 66), (63, 65))


def clips(seconds: float) -> dict[str, np.ndarray]:
    """Recordings by name, the beginning of each."""
    folders = ("speech_english", "emodb", "facegood_audio2face")
    files = [file for folder in folders for file in sorted((assets.ASSETS / folder).glob("*.flac"))]
    samples = {
        f"{file.parent.name}/{file.stem}": np.array(freetalk.load_audio(file).samples)
        for file in files
    }
    return {name: wave[: round(seconds * RATE_HZ)] for name, wave in samples.items()}


def opening(motion: np.ndarray) -> np.ndarray:
    """Change of the inner lips' distance (T,), m."""
    lips = [motion[:, upper, 1] - motion[:, lower, 1] for upper, lower in INNER_LIPS]
    return np.mean(lips, axis=0)


def seam_ratio(motion: np.ndarray, seams: list[int]) -> float:
    """Mean jerk of the mouth over differences that cross a seam, by that of the others."""
    jerk = np.linalg.norm(np.diff(motion[:, 48:], n=3, axis=0), axis=-1).mean(axis=-1)
    crosses = np.zeros(len(jerk), dtype=bool)
    for seam in seams:
        crosses[max(0, seam - 3) : seam] = True
    return float(jerk[crosses].mean() / jerk[~crosses].mean())


def play(
    face: freetalk.Face, wave: np.ndarray, options: dict[str, object], vertices: bool
) -> tuple[np.ndarray, list[int], float, float]:
    """Motion, seams, seconds spent, and the latency that a listener would have seen.

    Blocks of 20 ms are pushed at once; what each took is added to the moment when it was spoken.
    """
    live = face.live(**options)
    frames: list[freetalk.talker.LiveFrame] = []
    seams: list[int] = []
    busy = latency = free_at = 0.0
    block = RATE_HZ // 50
    for first in range(0, len(wave), block):
        start = time.perf_counter()
        made = live.push(wave[first : first + block])
        if vertices:
            for frame in made:
                live.decode(frame)
        took = time.perf_counter() - start
        busy += took
        spoken = min(first + block, len(wave)) / RATE_HZ
        free_at = max(free_at, spoken) + took
        if made:
            latency = max(latency, free_at - made[0].time_s)
            seams.append(made[0].index)
        frames += made
    start = time.perf_counter()
    frames += live.finish()
    busy += time.perf_counter() - start
    return np.stack([frame.landmarks.numpy() for frame in frames]), seams[1:], busy, latency


def table(face: freetalk.Face, arguments: argparse.Namespace) -> None:
    """Prints a row a clip, medians and worst cases."""
    options: dict[str, object] = {
        "emotion": arguments.emotion,
        "seed": 0,
        "blinks": False,
        "hop_s": arguments.hop,
        "num_steps": arguments.steps,
        "sampler": arguments.sampler,
    }
    offline = SpeechToMotion.of(WEIGHTS)
    play(face, np.zeros(RATE_HZ, np.float32), options, arguments.vertices)  # warm
    print(f"promised latency {face.live(**options).latency_s:.2f} s and the computing")
    heads = ("RTF", "latency s", "corr", "mm", "seam jerk", "offline's", "jerk / offline")
    print(f"{'clip':<36}" + "".join(f"{head:>15}" for head in heads))
    rows = []
    for name, wave in clips(arguments.seconds).items():
        motion, seams, busy, latency = play(face, wave, options, arguments.vertices)
        level = 1.0 if arguments.emotion == "neutral" else 2.0
        truth = offline.motion(offline.features(wave), arguments.emotion, level)
        jerks = [
            np.linalg.norm(np.diff(m[:, 48:], n=3, axis=0), axis=-1).mean() for m in (motion, truth)
        ]
        rows.append(
            (
                busy / (len(wave) / RATE_HZ),
                latency,
                float(np.corrcoef(opening(motion), opening(truth))[0, 1]),
                1e3 * float(np.linalg.norm(motion - truth, axis=-1)[:, 48:].mean()),
                seam_ratio(motion, seams),
                seam_ratio(truth, seams),
                jerks[0] / jerks[1],
            )
        )
        print(f"{name:<36}" + "".join(f"{value:15.3f}" for value in rows[-1]), flush=True)
    columns = np.array(rows).T
    worst = [
        column.min() if head == "corr" else column.max()
        for head, column in zip(heads, columns, strict=True)
    ]
    print(f"{'median':<36}" + "".join(f"{np.median(column):15.3f}" for column in columns))
    print(f"{'worst':<36}" + "".join(f"{value:15.3f}" for value in worst))


def resident_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def memory(face: freetalk.Face, minutes: float) -> None:
    """Prints resident memory of one long stream, and the cost of its hops."""
    wave = np.concatenate(list(clips(60).values()))
    live = face.live()
    block = RATE_HZ // 5
    marks = {1.0, minutes}
    costs: list[float] = []
    for index in range(round(minutes * 60 * 5)):
        first = index * block % (len(wave) - block)
        start = time.perf_counter()
        live.push(wave[first : first + block])
        costs.append(time.perf_counter() - start)
        passed = (index + 1) / 300
        if passed in marks:
            recent = 1e3 * float(np.median(costs[-150:]))
            print(
                f"after {passed:g} min: {resident_mb():.1f} MB resident, a hop costs {recent:.1f} ms",
                flush=True,
            )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Benchmark of live speech.")
    parser.add_argument("--seconds", type=float, default=12, help="of each clip")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--emotion", default="neutral")
    parser.add_argument("--hop", type=float, default=0.12)
    parser.add_argument("--steps", type=int, default=4)
    parser.add_argument("--sampler", choices=("dpmpp", "ddim"), default="dpmpp")
    parser.add_argument("--vertices", action="store_true", help="also decode every frame")
    parser.add_argument("--memory", type=float, metavar="MINUTES", help="of one stream, instead")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    vertices, faces = assets.mean_face("face")
    mesh = freetalk.Mesh(vertices, faces.tolist(), name="face")
    face = freetalk.Talker.from_pretrained(WEIGHTS, device="cpu").prepare(mesh, progress=False)
    if arguments.memory:
        memory(face, arguments.memory)
    else:
        table(face, arguments)


if __name__ == "__main__":
    main()
