#!/usr/bin/env python3
"""Draws the README's moving picture: one sentence on three surfaces that have nothing in common.

    python scripts/moving_picture.py [--pretrained DIR] [--out docs/speaking.webp]

From the left: a face of quads, the same meshed anew with few triangles, and a neural parametric head that no mesh was
given for.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from demo import write_face
from PIL import Image

import freetalk as ft
from freetalk import viz
from freetalk.corpus import assets

SECONDS, RATE = 4.4, 12.5
WIDTH, HEIGHT = 250, 290
FEW = 2000  # vertices


def main() -> None:
    """Animates, draws and writes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pretrained", default="open-small", help="name or folder of the weights")
    parser.add_argument(
        "--out", type=Path, default=Path("docs/speaking.webp"), help="WebP to write"
    )
    arguments = parser.parse_args()
    talker = ft.Talker.from_pretrained(arguments.pretrained)
    clip = ft.load_audio(assets.speech_clip())
    audio = ft.Audio(
        np.array(clip.samples)[: round(SECONDS * clip.sample_rate_hz)], clip.sample_rate_hz
    )
    face = ft.load_mesh(write_face(arguments.out.with_suffix(".obj")))
    arguments.out.with_suffix(".obj").unlink()
    takes = [
        talker.animate(audio, face, emotion="happy", intensity=2.0, seed=1),
        talker.animate(audio, few_triangles(face), emotion="surprise", intensity=2.0, seed=2),
        talker.prepare_head(talker.sample_identity(7)).animate(audio, seed=3),
    ]
    times = np.arange(round(SECONDS * RATE)) / RATE
    views = [viz.View(zoom=1.15), viz.View(zoom=1.15), viz.View(zoom=1.0, yaw_deg=-12.0)]
    columns = [
        viz.render_frames(take, times, (WIDTH, HEIGHT), view)
        for take, view in zip(takes, views, strict=True)
    ]
    frames = [Image.fromarray(np.concatenate(row, axis=1)) for row in zip(*columns, strict=True)]
    frames[0].save(
        arguments.out,
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 / RATE),
        loop=0,
        quality=55,
        method=6,
    )
    size = arguments.out.stat().st_size
    print(f"{arguments.out}: {len(frames)} frames, {size / 1e6:.2f} MB")


def few_triangles(mesh: ft.Mesh) -> ft.Mesh:
    """The same surface with few vertices."""
    import fast_simplification

    vertices, faces = fast_simplification.simplify(
        np.asarray(mesh.vertices, np.float32),
        np.asarray(mesh.faces, np.int32),
        target_reduction=1 - FEW / len(mesh.vertices),
    )
    return ft.Mesh(vertices.astype(np.float64), faces.tolist())


if __name__ == "__main__":
    main()
