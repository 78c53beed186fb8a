#!/usr/bin/env python3
"""Measures how far the landmarks-to-mesh network's output depends on the meshing of one and the same head.

    python scripts/bench/remeshing.py --corpus CORPUS
    python scripts/bench/remeshing.py --corpus CORPUS --pretrained DIR --out remeshing.json

Heads that training never saw (identities of the corpus's test split) move as its held-out sequences do, on the original
face of 9,409 vertices and on other meshings of it: crops, other splits of the quads, decimations, isotropic remeshings,
subdivisions. Every vertex of a meshing is a point of the original surface with known barycentric weights, so
outputs are compared at corresponding points:

    deviation = sum |output on the meshing - output on the original| / sum |output on the original|

over vertices and frames, and over the lips alone. Then 5 % of the faces are taken away at random, which leaves holes,
and the output is compared with that on the whole mesh at the same vertices. The error beside it is that of
the output against the corpus's own motion, as a share of that motion.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
import torch

import freetalk
from freetalk.corpus.assets import EXTENTS, FaceModel, load_face_model
from freetalk.corpus.topologies import (
    Meshing,
    crop,
    decimate,
    region_masks,
    remesh,
    short_diagonals,
    subdivide,
)
from freetalk.data import Dataset, MotionSequence, open_dataset
from freetalk.evaluate.writers import plain_table
from freetalk.geometry import surface_operators
from freetalk.stm import Stm

FloatArray = npt.NDArray[np.float32]
SHIPPED = Path(freetalk.__file__).parent / "pretrained" / "open-small"
ORIGINAL = "face"
SOURCE = "sockets"  # topology of the corpus that has all the vertices that meshings are made from

#: Besides the narrow crop none of the first five is in the corpus; the last two show more of the head.
MESHINGS: dict[str, Callable[[FaceModel], Meshing]] = {
    "narrow crop": lambda m: crop(m, "narrow"),
    "shorter diagonals": lambda m: short_diagonals(m, "face"),
    "decimated 3,300": lambda m: decimate(m, crop(m, "face"), 3300),
    "isotropic 4,000": lambda m: remesh(m, crop(m, "face"), 4000),
    "subdivided 9,100": lambda m: subdivide(decimate(m, crop(m, "face"), 2300)),
    "head and neck": lambda m: crop(m, "head"),
    "with sockets": lambda m: crop(m, "sockets"),
}
TORN = ("original", *list(MESHINGS)[:5])


def difference(ours: FloatArray, theirs: FloatArray, lips: npt.NDArray[np.bool_]) -> Any:
    """(4,) sums over frames (T, V, 3) of |ours - theirs| and |theirs|, then both at the lips."""
    apart = np.linalg.norm(ours - theirs, axis=-1)
    size = np.linalg.norm(theirs, axis=-1)
    return np.array([apart.sum(), size.sum(), apart[:, lips].sum(), size[:, lips].sum()])


def without_faces(faces: npt.NDArray[Any], share: float, seed: int) -> npt.NDArray[Any]:
    """The faces that stay when a share of them is taken away at random."""
    rng = np.random.default_rng(seed)
    return faces[np.sort(rng.permutation(len(faces))[round(share * len(faces)) :])]


def windows(corpus: Dataset, count: int, frames: int) -> Iterator[tuple[MotionSequence, int]]:
    """`count` stretches of each source of motion of the test split, drawn at random."""
    rng = np.random.default_rng(0)
    moving = [s for s in corpus.sequences("test") if s.num_frames >= frames and s.source != "rest"]
    for source in sorted({s.source for s in moving}):
        own = [s for s in moving if s.source == source]
        for _ in range(count):
            sequence = own[int(rng.integers(len(own)))]
            yield sequence, int(rng.integers(sequence.num_frames - frames + 1))


def carried(carry: sp.csr_matrix, motion: FloatArray) -> FloatArray:
    """(T, V, 3) of source vertices at a meshing's vertices."""
    return np.stack([carry @ frame for frame in motion])


class Heads:
    """One network, one head after the other."""

    def __init__(self, model: Stm, corpus: Dataset, arguments: argparse.Namespace) -> None:
        self.model, self.corpus, self.arguments = model, corpus, arguments
        self.source = load_face_model()
        frames = arguments.frames
        chosen = list(windows(corpus, arguments.windows, frames))
        landmarks = [corpus.landmarks(sequence, at, at + frames) for sequence, at in chosen]
        self.landmarks = torch.from_numpy(np.concatenate(landmarks))
        self.true = np.concatenate(
            [
                corpus.vertex_displacements(SOURCE, sequence, at, at + frames)
                for sequence, at in chosen
            ]
        )
        self.lips = region_masks(self.source)[0][: EXTENTS[SOURCE]]

    def output(self, vertices: npt.NDArray[np.float64], faces: npt.NDArray[Any]) -> FloatArray:
        """(T, V, 3) displacements that the network gives, m."""
        options = self.model.options
        operators = surface_operators(
            vertices / options.length_scale,
            faces,
            k=options.k_eig,
            laplacian=self.arguments.laplacian,
            cache=False,
        ).to(dtype=torch.float32)
        positions = torch.from_numpy(vertices).float()
        decoder = self.model.frame_decoder(self.model.encode(positions, operators), operators)
        result: FloatArray = decoder.decode(self.landmarks).numpy()
        return result


def compare(heads: Heads, identities: list[int], meshings: dict[str, Meshing]) -> dict[str, Any]:
    """Deviations by meshing and, for torn ones, by seed."""
    sums: dict[str, Any] = {}

    def add(name: str, part: str, values: Any) -> None:
        row = sums.setdefault(name, {})
        row[part] = row.get(part, 0) + values

    inside = np.arange(EXTENTS[SOURCE]) < EXTENTS[ORIGINAL]
    for identity in identities:
        neutral = heads.corpus.mesh(identity, SOURCE).vertices.astype(np.float64)
        original = heads.output(neutral[inside], meshings["original"].faces)
        for name, meshing in meshings.items():
            carry = meshing.carry[:, : EXTENTS[SOURCE]]
            vertices, lips = carry @ neutral, carry @ heads.lips > 0.5
            true = carried(carry, heads.true)
            whole = original if name == "original" else heads.output(vertices, meshing.faces)
            add(name, "error", difference(whole, true, lips))
            common = carry @ ~inside == 0  # points of the original face
            expected = carried(carry[common][:, inside], original)
            add(name, "deviation", difference(whole[:, common], expected, lips[common]))
            for seed in range(heads.arguments.seeds if name in TORN else 0):
                faces = without_faces(meshing.faces, heads.arguments.share, seed)
                torn = heads.output(vertices, faces)
                for part in (f"seed {seed}", "deviation"):
                    add(f"{name}, torn", part, difference(torn, whole, lips))
                add(f"{name}, torn", "error", difference(torn, true, lips))
            print(f"head {identity}, {name}: {len(vertices)} vertices", file=sys.stderr)
    return {
        name: {
            part: {"everywhere": float(v[0] / v[1]), "lips": float(v[2] / v[3])}
            for part, v in row.items()
        }
        for name, row in sums.items()
    }


def rows_of(scores: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    yield ("meshing", "deviation", "lips", "error", "lips")
    for name, row in scores.items():
        deviation, error = row["deviation"], row["error"]
        cells = (*deviation.values(), *error.values())
        yield (name, *(f"{100 * value:.2f} %" for value in cells))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--corpus", type=Path, required=True, help="folder of the open corpus")
    parser.add_argument("--pretrained", type=Path, default=SHIPPED, help="folder of the weights")
    parser.add_argument("--heads", type=int, default=2, help="identities of the test split")
    parser.add_argument("--windows", type=int, default=2, help="windows of each source of motion")
    parser.add_argument("--frames", type=int, default=8, help="frames of a window")
    parser.add_argument("--seeds", type=int, default=3, help="sets of faces taken away")
    parser.add_argument("--share", type=float, default=0.05, help="of the faces taken away")
    parser.add_argument("--meshings", nargs="+", choices=MESHINGS, default=list(MESHINGS))
    parser.add_argument("--laplacian", choices=("cotan", "robust"), default="cotan")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    corpus = open_dataset(arguments.corpus)
    heads = Heads(Stm.from_pretrained(arguments.pretrained / "stm").eval(), corpus, arguments)
    meshings = {"original": crop(heads.source, ORIGINAL)}
    meshings |= {name: MESHINGS[name](heads.source) for name in arguments.meshings}
    with torch.no_grad():
        scores = compare(heads, corpus.identities("test")[: arguments.heads], meshings)
    print(f"{arguments.pretrained}: {len(heads.landmarks)} frames, {arguments.heads} heads")
    print(plain_table(list(rows_of(scores))))
    if arguments.out:
        arguments.out.write_text(json.dumps(scores, indent=2) + "\n")


if __name__ == "__main__":
    main()
