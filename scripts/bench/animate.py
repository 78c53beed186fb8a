#!/usr/bin/env python3
"""Time and memory of the whole pipeline, stage by stage.

    python scripts/bench/animate.py [--threads 2] [--repetitions 1] [--precision bfloat16]

Every row is a process of its own, without any cache of earlier runs: speech of 10 and 60 s on a face of 9,409
vertices, 10 s on one of 50,000. Prints seconds to load weights and mesh, each stage of the one call ("cold"),
the same clip once more on the prepared face ("warm"), frames decoded, and the peak of resident memory.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

STAGES = ("align", "parts", "operators", "features", "speech", "motion", "surface")
CASES = ((9_409, 10), (9_409, 60), (50_000, 10))


def speech(seconds: float) -> np.ndarray:
    """Recorded English, repeated to the length, (S,) at 16 kHz."""
    import freetalk
    from freetalk.corpus import assets

    clip = np.array(freetalk.load_audio(assets.speech_clip()).samples)
    return np.resize(clip, round(seconds * 16000))


def face(num_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """The mean face; for more vertices each of its triangles cut into four, and simplified to as many."""
    from freetalk.corpus import assets

    vertices, faces = assets.mean_face("face")
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
    while len(vertices) < num_vertices:
        vertices, faces = subdivide(vertices, faces)
    return simplified(vertices, faces, num_vertices)


def subdivide(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every edge cut in its middle."""
    triangles = (
        faces if faces.shape[1] == 3 else np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])
    )
    edges = np.sort(np.concatenate([triangles[:, [a, (a + 1) % 3]] for a in range(3)]), axis=1)
    unique, of_edge = np.unique(edges, axis=0, return_inverse=True)
    middle = len(vertices) + of_edge.reshape(3, -1).T  # (F, 3): of edges 01, 12, 20
    a, b, c = triangles.T
    ab, bc, ca = middle.T
    parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return (
        np.concatenate([vertices, vertices[unique].mean(axis=1)]),
        np.concatenate([np.stack(part, axis=1) for part in parts]),
    )


def simplified(
    vertices: np.ndarray, faces: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """About `count` vertices of the same surface, by quadric error."""
    if len(vertices) == count:
        return vertices, faces
    import fast_simplification

    triangles = (
        faces if faces.shape[1] == 3 else np.concatenate([faces[:, :3], faces[:, [0, 2, 3]]])
    )
    wanted = round(len(triangles) * count / len(vertices))
    return fast_simplification.simplify(
        vertices.astype(np.float32), triangles.astype(np.int32), target_count=wanted
    )


def measure(mesh_file: str, seconds: float, threads: int, precision: str) -> dict[str, object]:
    """One case, in this process."""
    clock = time.perf_counter
    import torch

    import freetalk

    torch.set_num_threads(threads)
    wave = speech(seconds)
    start = clock()
    talker = freetalk.Talker.from_pretrained(device="cpu")
    mesh = freetalk.load_mesh(mesh_file)
    audio = freetalk.Audio(wave, 16000)
    loaded = clock()
    prepared = talker.prepare(mesh, cache_dir=None, precision=precision, progress=False)
    cold = clock()
    animation, report = prepared.animate_with_report(audio, emotion="happy", progress=False)
    ended = clock()
    stages = {**prepared.report.timings, **report.timings}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    frames = animation.num_frames
    del animation
    again = clock()
    prepared.animate_with_report(audio, emotion="happy", seed=1, progress=False)
    return {
        "frames": frames,
        "decoded": report.decoded_frames,
        "load": loaded - start,
        "stages": stages,
        "cold": ended - loaded,
        "prepare": cold - loaded,
        "warm": clock() - again,
        "peak_mb": peak,
        "error_mm": report.decode_error_mm,
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Benchmark of animate.")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=1)
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--case", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.case:
        mesh_file, spoken = arguments.case
        found = measure(mesh_file, float(spoken), arguments.threads, arguments.precision)
        print(json.dumps(found))
        return
    heads = ("load", *STAGES, "cold", "warm", "peak MB", "decoded")
    print(f"{'vertices':>8} {'speech':>7}" + "".join(f"{head:>11}" for head in heads))
    with tempfile.TemporaryDirectory() as folder:
        table(arguments, Path(folder))


def table(arguments: argparse.Namespace, folder: Path) -> None:
    """Prints a row a process."""
    from freetalk.mesh import Mesh, save_mesh

    for vertices, seconds in CASES:
        mesh_file = folder / f"{vertices}.ply"
        if not mesh_file.exists():
            points, faces = face(vertices)
            save_mesh(mesh_file, Mesh(points, faces.tolist(), name="face"))
        for _ in range(arguments.repetitions):
            command = [sys.executable, __file__, "--case", str(mesh_file), str(seconds)]
            command += ["--threads", str(arguments.threads), "--precision", arguments.precision]
            run = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
            values = [run["load"], *(run["stages"][s] for s in STAGES), run["cold"], run["warm"]]
            print(
                f"{vertices:8d} {seconds:5d} s"
                + "".join(f"{value:11.2f}" for value in values)
                + f"{run['peak_mb']:11.0f}{run['decoded']:7d}/{run['frames']}",
                flush=True,
            )


if __name__ == "__main__":
    main()
