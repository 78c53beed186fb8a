#!/usr/bin/env python3
"""Draws generated faces beside the recordings that their speech comes from: the opening of the lips over time.

    scripts/figure_recorded.py --data TALKERS [--split val] [--pretrained open-small] [--out docs/recorded_clips.png]

``TALKERS`` is a dataset of tracked talkers (``freetalk data from-video``): a row each of its first clips, in three
emotions. A face is shown at the moment at which its lips are furthest apart; the curves are of the built-in face's
inner lips and of the recording's landmarks.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

import freetalk as ft
from freetalk import viz
from freetalk.cli.animate import built_in_face
from freetalk.corpus.assets import load_face_model
from freetalk.data import open_dataset
from freetalk.data.landmarks import LOWER_INNER_LIP, UPPER_INNER_LIP, lip_opening

EMOTIONS = (("neutral", 1.0), ("happy", 2.0), ("angry", 2.0))
ROWS, CELL = 4, 200

FloatArray = npt.NDArray[np.float32]


def mesh_opening(animation: ft.Animation) -> FloatArray:
    """(T,) m, of the built-in face's inner lips beyond those of its rest."""
    upper, lower = load_face_model().landmarks68[[UPPER_INNER_LIP, LOWER_INNER_LIP]]
    height = animation.displacements[..., 1]
    opening: FloatArray = (height[:, upper] - height[:, lower]).numpy()
    return opening


def draw(data: Path, split: str, pretrained: str, out: Path) -> None:
    """Writes the figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    dataset = open_dataset(data)
    clips = [clip for clip in dataset.sequences(split) if clip.has_sound][:ROWS]
    face = ft.Talker.from_pretrained(pretrained).prepare(built_in_face())
    figure = Figure(figsize=(4.2 * len(EMOTIONS), 1.7 * len(clips)), layout="constrained")
    cells = figure.subplots(len(clips), 2 * len(EMOTIONS), width_ratios=(1, 2) * len(EMOTIONS))
    for row, clip in zip(np.atleast_2d(cells), clips, strict=True):
        sound = ft.Audio(dataset.audio(clip), dataset.sample_rate_hz)
        recorded = 1000 * lip_opening(dataset.landmarks(clip))
        for (emotion, intensity), picture, curve in zip(EMOTIONS, row[::2], row[1::2], strict=True):
            animation = face.animate(
                sound, emotion=emotion, intensity=intensity, fps=clip.fps, progress=False
            )
            made = 1000 * mesh_opening(animation)
            moment = int(made.argmax()) / clip.fps
            picture.imshow(viz.render_frame(animation, moment, (CELL, CELL)))
            picture.set_axis_off()
            curve.plot(np.arange(len(recorded)) / clip.fps, recorded, color="0.6", label="recorded")
            curve.plot(np.arange(len(made)) / clip.fps, made, color="C0", label="generated")
            frames = min(len(made), len(recorded))
            r = float(np.corrcoef(made[:frames], recorded[:frames])[0, 1])
            curve.set_title(f"{clip.id}, {emotion}: r = {r:.2f}", fontsize=7)
            curve.tick_params(labelsize=6)
    for curve in np.atleast_2d(cells)[-1, 1::2]:
        curve.set_xlabel("s", fontsize=7)
    for curve in np.atleast_2d(cells)[:, 1]:
        curve.set_ylabel("mm", fontsize=7)
    np.atleast_2d(cells)[0, 1].legend(fontsize=6)
    FigureCanvasAgg(figure).print_png(out, pil_kwargs={"optimize": True})
    print(out)


def main() -> None:
    """Reads the arguments."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, required=True, help="folder of tracked talkers")
    parser.add_argument("--split", default="val", help="of the data")
    parser.add_argument("--pretrained", default="open-small", help="weights: a name or a folder")
    parser.add_argument("--out", type=Path, default=Path("docs/recorded_clips.png"))
    arguments = parser.parse_args()
    draw(arguments.data, arguments.split, arguments.pretrained, arguments.out)


if __name__ == "__main__":
    main()
