#!/usr/bin/env python3
"""Draws FaceTalk's figures from weights.

    python scripts/figures_facetalk.py --data CORPUS [--pretrained open-small] [--facetalk NAME=DIR ...]
        [--landmarks DIR] [--out results/open/figures]

facetalk_heads.png       the same codes on several heads, and several samples on one [FaceTalk, Fig. 5]
facetalk_ablations.png   the same speech by --facetalk's weights, such as rows of table_facetalk_2 [Fig. 7]
facetalk_landmarks.png   truth, its landmarks, and weights trained with model.condition=landmarks [Fig. 8]

Fig. 9 comes with scripts/table_facetalk_4.py.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from figures import clip, strips

import freetalk as ft
from freetalk import viz
from freetalk._pretrained import find_weights
from freetalk.corpus.assets import load_face_model, mean_face
from freetalk.data import Dataset, lip_opening, open_dataset
from freetalk.evaluate.facetalk import SpeechToCodes

SECONDS = 2
IDENTITIES, SAMPLES = (7, 3, 12), (1, 2, 3)
COLUMNS, CELL = 6, 180


def draw_heads(talker: ft.Talker, audio: ft.Audio, out: Path) -> Path:
    """The same codes on several heads, then other samples on the first."""
    rows, labels = [], []
    faces = [talker.prepare_head(talker.sample_identity(n), progress=False) for n in IDENTITIES]
    for face, number in zip(faces, IDENTITIES, strict=True):
        rows.append(face.animate(audio, motion="facetalk", seed=SAMPLES[0], progress=False))
        labels.append(f"head {number}")
    for seed in SAMPLES[1:]:
        varied = {"sampler": "dpmpp", "num_steps": 20, "mouth_temperature": 1.0, "seed": seed}
        rows.append(faces[0].animate(audio, motion="facetalk", progress=False, **varied))
        labels.append(f"sample {seed}")
    return strips(rows, labels, audio, out / "facetalk_heads.png")


def draw_ablations(
    pretrained: Path, weights: list[tuple[str, Path]], audio: ft.Audio, out: Path
) -> Path:
    """A row for each of the weights, on one mesh."""
    vertices, faces = mean_face("face")
    rows = []
    for _, directory in weights:
        with tempfile.TemporaryDirectory() as folder:
            for part in pretrained.iterdir():
                if part.name != "facetalk":
                    (Path(folder) / part.name).symlink_to(part.resolve())
            (Path(folder) / "facetalk").symlink_to(directory.resolve())
            talker = ft.Talker.from_pretrained(folder)
        mesh = ft.Mesh(vertices, faces)
        rows.append(talker.animate(audio, mesh, motion="facetalk", seed=1, progress=False))
    labels = [name for name, _ in weights]
    return strips(rows, labels, audio, out / "facetalk_ablations.png")


def draw_landmarks(corpus: Dataset, pretrained: Path, weights: Path, out: Path) -> Path:
    """Moments of a captured take: the true face, its landmarks, the face of the codes that they ask for."""
    model = SpeechToCodes(pretrained / "speech", weights, {"sampler": "dpmpp", "num_steps": 20})
    if model.model.options.condition != "landmarks":
        raise ValueError(f"{weights} hears speech; train with model.condition=landmarks")
    take = next(s for s in corpus.sequences("test") if s.source == "facegood")
    take = take.clip(take.id, 0, min(take.num_frames, round(10 * take.fps)))
    at = corpus.select([take]).at(model.fps)
    own = at.sequences()[0]
    with torch.no_grad():
        codes = model.codes(model.heard(corpus, take), [0])[0].cpu().numpy()
    true, landmarks = at.weights(own)[: len(codes)], at.landmarks(own)[: len(codes)]
    order = np.argsort(lip_opening(landmarks))
    moments = order[np.linspace(0, len(order) - 1, COLUMNS).astype(int)]
    face, (vertices, faces) = load_face_model(), mean_face("face")
    basis = face.expression_basis[:, : len(vertices)]
    columns = [face.index(name) for name in corpus.expressions]
    neutral = face.neutral[face.landmarks68]
    rows = []
    for values in (true, codes):
        motion = np.tensordot(values[moments], basis[columns], 1).astype(np.float32)
        shown = viz.Sequence(vertices, faces.astype(np.int64), motion, 1.0, located=True)
        rows.append(viz.render_frames(shown, range(len(moments)), (CELL, CELL)))
    dots = []
    for moment in moments:
        cell = np.full((CELL, CELL, 3), 255, np.uint8)
        at_px = (neutral + landmarks[moment])[:, :2] * (CELL / 0.2) * [1, -1] + CELL / 2
        for x, y in np.rint(at_px).astype(int).clip(1, CELL - 2):
            cell[y - 1 : y + 2, x - 1 : x + 2] = (30, 60, 120)
        dots.append(cell)
    labels = ["truth", "landmarks", "spoken\nby them"]
    path = out / "facetalk_landmarks.png"
    return viz.contact_sheet([rows[0], dots, rows[1]], labels, path, moments / own.fps)


def main() -> None:
    """Draws what the arguments ask for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", required=True, metavar="DIR", help="the open corpus")
    parser.add_argument(
        "--pretrained", default="open-small", help="weights with facetalk/ and head/"
    )
    parser.add_argument(
        "--facetalk", action="append", default=[], metavar="NAME=DIR", help="a row of Fig. 7"
    )
    parser.add_argument("--landmarks", type=Path, metavar="DIR", help="weights that hear landmarks")
    parser.add_argument("--out", type=Path, default=Path("results/open/figures"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    audio = clip(SECONDS)
    pretrained = find_weights(given.pretrained)
    if given.facetalk:
        pairs = [spec.partition("=") for spec in given.facetalk]
        weights = [(name, Path(folder)) for name, _, folder in pairs]
        print(draw_ablations(pretrained, weights, audio, given.out))
    if given.landmarks is not None:
        print(draw_landmarks(open_dataset(given.data), pretrained, given.landmarks, given.out))
    if not given.facetalk and given.landmarks is None:
        print(draw_heads(ft.Talker.from_pretrained(pretrained), audio, given.out))


if __name__ == "__main__":
    main()
