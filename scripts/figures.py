#!/usr/bin/env python3
"""Draws FreeTalk's figures from weights: errors on the mesh, attention, moments of speech on several faces.

    python scripts/figures.py --data CORPUS [--pretrained DIR] [--stm NAME=DIR ...] [--out results/open/figures]

errors.png      distance of each vertex from the truth, true landmarks given [supp. Fig. 1]
attention.png   how much each vertex looks at a landmark, mean over heads [supp. Fig. 2]
emotions.png    one sentence in three emotions, moments side by side [Fig. 4]
topologies.png  the same speech on meshings that training never saw [Fig. 5]

With --stm, errors.png shows a column for each folder of weights, such as rows of scripts/table_supp_1.py.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from PIL import Image

import freetalk as ft
from freetalk import viz
from freetalk._pretrained import PRETRAINED
from freetalk.corpus import assets
from freetalk.data import Dataset, FaceMesh, MotionSequence, lip_opening, open_dataset
from freetalk.stm import Stm
from freetalk.train.stm_meshes import prepare_mesh

FIGURES = ("errors", "attention", "emotions", "topologies")
#: (landmark, what it is): below the lower lip, a corner of the mouth, a brow, the tip of the chin.
LANDMARKS = ((57, "lower lip"), (48, "corner of the mouth"), (41, "lower lid"), (8, "chin"))
EMOTIONS = (("neutral", 1.0), ("happy", 3.0), ("angry", 3.0))
MOMENTS = 6
CELL = 180


class Still:
    """The most open moment of a held-out take (a neutral one if there is any) on a face that training never saw.

    Args:
        corpus: the open corpus.
        topology: meshing of its test split.
    """

    def __init__(self, corpus: Dataset, topology: str) -> None:
        self.corpus, self.topology = corpus, topology
        self.identity = corpus.identities("test")[0]
        self.mesh: FaceMesh = corpus.mesh(self.identity, topology)
        takes = [s for s in corpus.sequences("test") if s.source not in ("rom", "rest")]
        neutral = [s for s in takes if s.emotion == 0]
        self.sequence: MotionSequence = (neutral or takes)[0]
        self.frame = int(np.argmax(lip_opening(corpus.landmarks(self.sequence))))
        at = (self.frame, self.frame + 1)
        self.landmarks = torch.from_numpy(corpus.landmarks(self.sequence, *at))
        self.motion = corpus.vertex_displacements(topology, self.sequence, *at)[0]

    def vertex_of(self, landmark: int) -> int:
        """The vertex nearest to a landmark of the mean face."""
        model = assets.load_face_model()
        point = model.neutral[model.landmarks68[landmark]]
        return int(np.square(self.mesh.vertices - point).sum(axis=1).argmin())

    def encoded(self, stm: Stm) -> tuple[ft.stm.MeshFeatures, ft.geometry.SurfaceOperators]:
        """The face's features under a network, and its operators."""
        options = stm.options
        face = prepare_mesh(
            self.corpus, self.identity, self.topology, options.length_scale, options.k_eig
        )
        with torch.no_grad():
            return stm.encode(face.positions, face.operators), face.operators


def draw_errors(still: Still, weights: list[tuple[str, Path]], out: Path) -> Path:
    """Errors of every network at the moment, on the predicted face."""
    faces, errors = [], []
    for _, directory in weights:
        stm = Stm.from_pretrained(directory).eval()
        features, operators = still.encoded(stm)
        with torch.no_grad():
            guess = stm.decode(features, operators, still.landmarks)[0].numpy()
        faces.append(still.mesh.vertices + guess)
        errors.append(1000 * np.linalg.norm(guess - still.motion, axis=-1))
    motion = 1000 * np.linalg.norm(still.motion, axis=-1)
    limits = (0.0, float(np.quantile(np.concatenate(errors), 0.998)))
    titles = [
        f"{name}\nmean {error.mean():.2f} mm, largest {error.max():.1f} mm"
        for (name, _), error in zip(weights, errors, strict=True)
    ]
    images = [
        viz.heat_map(face, still.mesh.faces, error, limits)
        for face, error in zip(faces, errors, strict=True)
    ]
    truth = still.mesh.vertices + still.motion
    images.insert(0, viz.heat_map(truth, still.mesh.faces, motion, limits))
    titles.insert(0, f"no network: the motion itself\nmean {motion.mean():.2f} mm")
    return viz.heat_sheet(images, titles, out / "errors.png", limits, "distance, mm")


def draw_attention(still: Still, directory: Path, out: Path) -> Path:
    """Weights of four landmarks over the surface at the moment, each by its largest."""
    stm = Stm.from_pretrained(directory).eval()
    features, _ = still.encoded(stm)
    with torch.no_grad():
        weights = stm.attention(features, still.landmarks)[0].mean(dim=0).numpy()  # (V, 68)
    face = still.mesh.vertices + still.motion
    images, titles = [], []
    for landmark, name in LANDMARKS:
        largest = float(weights[:, landmark].max())
        share = weights[:, landmark] / largest
        mark = face[still.vertex_of(landmark)]
        images.append(viz.heat_map(face, still.mesh.faces, share, (0.0, 1.0), mark=mark))
        titles.append(f"landmark {landmark + 1}, {name}\nlargest weight {largest:.2g}")
    label = "weight by its largest"
    return viz.heat_sheet(images, titles, out / "attention.png", (0.0, 1.0), label)


def draw_emotions(talker: ft.Talker, mesh: ft.Mesh, audio: ft.Audio, out: Path) -> Path:
    """Rows are emotions, columns moments of the speech."""
    rows = [
        talker.animate(audio, mesh, emotion=emotion, intensity=intensity, seed=1, progress=False)
        for emotion, intensity in EMOTIONS
    ]
    labels = [f"{emotion}\n{intensity:g}" for emotion, intensity in EMOTIONS]
    return strips(rows, labels, audio, out / "emotions.png")


def draw_topologies(
    talker: ft.Talker, corpus: Dataset, names: list[str], audio: ft.Audio, out: Path
) -> Path:
    """Rows are meshings of the test split on different faces, columns moments of the speech."""
    people = corpus.identities("test")
    rows, labels = [], []
    for at, name in enumerate(names):
        face = corpus.mesh(people[(at + 1) % len(people)], name)
        mesh = ft.Mesh(face.vertices, face.faces)
        rows.append(
            talker.animate(audio, mesh, emotion="surprise", intensity=2.0, seed=1, progress=False)
        )
        labels.append(f"{len(face.vertices)}\nvertices")
    return strips(rows, labels, audio, out / "topologies.png")


def strips(rows: list[ft.Animation], labels: list[str], audio: ft.Audio, path: Path) -> Path:
    """Rows of moments that part the speech into pieces of equal sound energy, in 192 colours."""
    energy = np.cumsum(np.square(np.asarray(audio.samples, dtype=np.float64)))
    wanted = (np.arange(MOMENTS) + 0.5) / MOMENTS * energy[-1]
    times = np.searchsorted(energy, wanted) / audio.sample_rate_hz
    viz.contact_sheet(rows, labels, path, times_s=times, cell=CELL, view=viz.View(zoom=1.15))
    Image.open(path).quantize(192).save(path, optimize=True)
    return path


def clip(seconds: float) -> ft.Audio:
    """The beginning of the speech that ships."""
    audio = ft.load_audio(assets.speech_clip())
    samples = np.asarray(audio.samples)[: round(seconds * audio.sample_rate_hz)]
    return ft.Audio(samples, audio.sample_rate_hz)


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of the open corpus")
    parser.add_argument("--pretrained", type=Path, default=PRETRAINED / "open-small")
    parser.add_argument(
        "--stm", action="append", default=[], metavar="NAME=DIR", help="weights for errors.png"
    )
    parser.add_argument("--out", type=Path, default=Path("results/open/figures"))
    parser.add_argument("--only", nargs="+", choices=FIGURES, default=list(FIGURES))
    parser.add_argument("--topology", default="", help="test meshing of errors and attention")
    parser.add_argument("--seconds", type=float, default=4.0, help="of speech")
    given = parser.parse_args(arguments)
    corpus = open_dataset(given.data)
    unseen = corpus.topologies("test")
    own = given.pretrained / "stm"
    compared = [(name, Path(path)) for name, _, path in (text.partition("=") for text in given.stm)]
    still = Still(corpus, given.topology or unseen[0])
    if "errors" in given.only:
        print(draw_errors(still, compared or [("shipped weights", own)], given.out))
    if "attention" in given.only:
        print(draw_attention(still, own, given.out))
    if {"emotions", "topologies"} & set(given.only):
        talker, audio = ft.Talker.from_pretrained(given.pretrained), clip(given.seconds)
        if "emotions" in given.only:
            mesh = ft.Mesh(still.mesh.vertices, still.mesh.faces)
            print(draw_emotions(talker, mesh, audio, given.out))
        if "topologies" in given.only:
            print(draw_topologies(talker, corpus, unseen, audio, given.out))


if __name__ == "__main__":
    main()
