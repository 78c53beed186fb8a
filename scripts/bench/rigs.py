#!/usr/bin/env python3
"""Measures the landmarks-to-mesh network on heads whose expressions were not made by the corpus's artist.

    python scripts/bench/rigs.py --corpus CORPUS --data ../shared/data
    python scripts/bench/rigs.py --corpus CORPUS --data ../shared/data --pretrained DIR --rigs mhr --out rigs.json

The rigs are built by rule, with nothing of the training's: the jaw turns about a hinge behind the ears with a share
that is harmonic over the surface, muscles pull the skin towards where they are fixed, weaker with the distance
[Waters 1987, "A muscle model for animating three-dimensional facial expression"]. They play the captured range of
motion and held-out takes of the corpus, expression by expression. `mhr` (the head of the Momentum Human Rig) was looked
at while the network was made, `mhr-wide` and `ict` (a drawn identity of the built-in face with other muscles) for the
final figures only.

    error = sum |output - true| / sum |true|

over all vertices, those of the front of the face (within 45 mm of a landmark, in front of the ears), and the lips
(within 6 mm of a lip landmark); beside it that at the landmarks themselves and the slope of the output over the truth.
Landmarks are "known" (those of the rig), "guessed" (where the mean face has them), or not followed at all ("plain").
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import freetalk
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.corpus.linear_face import built_in_face
from freetalk.data import Dataset, open_dataset
from freetalk.evaluate.writers import plain_table
from freetalk.geometry import cotan_laplacian, surface_operators
from freetalk.mesh import vertex_normals
from freetalk.stm import FollowOptions, LandmarkFollower, Stm

Points = npt.NDArray[np.float64]
SHIPPED = Path(freetalk.__file__).parent / "pretrained" / "open-small"
#: Distance between the outer corners of the eyes that sizes below are given for (m).
USUAL_EYES_M = 0.09
GUESSED_NOISE = 0.05


@dataclass(frozen=True)
class Style:
    """How a rig's artist works.

    Attributes:
        size: factor of all motion.
        radius: factor of the muscles' reach.
        edge: power of the muscles' falloff.
        jaw: power of the jaw's share.
        neck_m: how far below the chin the jaw pulls.
    """

    size: float = 1.0
    radius: float = 1.0
    edge: float = 1.0
    jaw: float = 1.0
    neck_m: float = 0.03


def step(x: Points) -> Points:
    """Smooth from 0 at 0 to 1 at 1."""
    u = np.clip(x, 0, 1)
    return np.asarray(u * u * (3 - 2 * u))


class MuscleRig:
    """Expressions of a head, (V, 3) each, by ICT's names.

    Args:
        vertices: (V, 3) m, canonical frame.
        faces: (F, 3).
        landmarks: (68,) vertices.
        style: of the artist.
    """

    def __init__(
        self, vertices: Points, faces: npt.NDArray[Any], landmarks: npt.NDArray[Any], style: Style
    ) -> None:
        self.vertices, self.faces, self.landmarks, self.style = vertices, faces, landmarks, style
        self.marks = vertices[landmarks]
        self.unit = float(np.linalg.norm(self.marks[36] - self.marks[45])) / USUAL_EYES_M
        self.share = self._jaw_share()
        self.lower = step(2 * self.share - 0.5)
        self.shapes: dict[str, Points] = {}
        self._jaw()
        self._mouth()
        for side, suffix in ((1, "_L"), (-1, "_R")):
            self._side(side, suffix)
        closing = step(self._falloff(self.marks[48:60].mean(axis=0), 0.045)) * self.lower
        self.shapes["mouthClose"] = -0.8 * closing[:, None] * self.shapes["jawOpen"]

    def basis(self, names: tuple[str, ...]) -> Points:
        """(E, V, 3) of names; expressions that the rig does not have are still."""
        still = np.zeros_like(self.vertices)
        return np.stack([self.shapes.get(name, still) for name in names])

    def _add(self, name: str, motion: Points) -> None:
        self.shapes[name] = self.shapes.get(name, 0.0) + self.style.size * motion

    def _jaw_share(self) -> Points:
        """(V,) 1 on chin and lower lip, 0 on upper lip, nose, eyes, skull and neck, harmonic between."""
        value = np.full(len(self.vertices), np.nan)
        behind = self.vertices[:, 2] < self.marks[[0, 16], 2].mean() - 0.01
        value[behind | (self.vertices[:, 1] < self.marks[8, 1] - self.style.neck_m)] = 0
        value[self.landmarks[[0, 16, *range(17, 48), *range(49, 54), 61, 62, 63]]] = 0
        value[self.landmarks[[*range(5, 12), *range(55, 60), 65, 66, 67]]] = 1
        laplacian = sp.csr_matrix(cotan_laplacian(self.vertices, self.faces))
        free, known = np.flatnonzero(np.isnan(value)), np.flatnonzero(~np.isnan(value))
        pull = laplacian[free][:, known] @ value[known]
        value[free] = spsolve(sp.csc_matrix(laplacian[free][:, free]), -pull)
        return np.asarray(np.clip(value, 0, 1) ** self.style.jaw)

    def _turned(self, axis: tuple[float, float, float], degrees: float) -> Points:
        """The jaw's share of a rotation about the hinge."""
        ears = self.marks[[0, 1, 15, 16]]
        hinge = np.array([0.0, ears[1:3, 1].mean() + 0.012 * self.unit, ears[[0, 3], 2].mean()])
        angles = np.deg2rad(degrees) * self.share
        turned = Rotation.from_rotvec(angles[:, None] * np.array(axis)).apply(self.vertices - hinge)
        return np.asarray(turned - (self.vertices - hinge))

    def _falloff(self, centre: Points, radius: Any) -> Points:
        """(V,) 1 at a centre, 0 beyond a radius (one, or one an axis; m of a usual face)."""
        reach = np.asarray(radius) * self.unit * self.style.radius
        far = np.linalg.norm((self.vertices - centre) / reach, axis=1)
        return np.asarray(np.cos(np.clip(far, 0, 1) * np.pi / 2) ** self.style.edge)

    def _front(self) -> Points:
        start = self.marks[[36, 45], 2].mean() - 0.05 * self.unit
        return step((self.vertices[:, 2] - start) / (0.03 * self.unit))

    def _muscle(
        self, skin: Points, bone: Any, radius: float, pull_m: float, only: Any = 1.0
    ) -> Points:
        """(V, 3) what a muscle from a place on the bone to one of the skin does where it contracts.

        Args:
            skin: (3,) where it ends.
            bone: (3,) where it is fixed, or from `skin` in m of a usual face if shorter than that.
            radius: of the skin that it moves, m of a usual face.
            pull_m: how far `skin` moves, m of a usual face.
            only: (V,) share of the vertices that it moves.
        """
        share = self._falloff(skin, radius) * self._front() * only
        towards = bone - self.vertices
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        straight = (bone - skin) / np.linalg.norm(bone - skin)
        return np.asarray(share[:, None] * (0.6 * towards + 0.4 * straight) * pull_m * self.unit)

    def _jaw(self) -> None:
        share = self.share[:, None] * self.unit
        self._add("jawOpen", self._turned((1, 0, 0), 22) + share * [0, 0, 0.004])
        self._add("jawForward", share * [0, 0, 0.008])
        self._add("jawLeft", self._turned((0, 1, 0), 6))
        self._add("jawRight", self._turned((0, -1, 0), 6))

    def _mouth(self) -> None:
        u, marks, upper = self.unit, self.marks, 1 - self.lower
        middle = marks[48:60].mean(axis=0)
        for name, side in (("mouthLeft", 1), ("mouthRight", -1)):
            self._add(name, self._muscle(middle, middle + [side * 0.06 * u, 0, 0], 0.045, 0.010))
        ring = (self._falloff(middle, [0.04, 0.035, 0.05]) * self._front())[:, None]
        inward = (middle - self.vertices) * [1, 0.35, 0]
        self._add("mouthPucker", ring * (0.45 * inward + [0, 0, 0.007 * u]))
        apart = (upper - self.lower)[:, None] * [0, 0.005 * u, 0]
        self._add("mouthFunnel", ring * (0.25 * inward + [0, 0, 0.010 * u] + apart))
        top, bottom, nose = marks[51], marks[57], marks[33]
        into = np.array([0, 0.02 * u, -0.03 * u])
        self._add("mouthRollUpper", self._muscle(top, top + into * [0, -1, 1], 0.022, 0.006, upper))
        self._add("mouthRollLower", self._muscle(bottom, bottom + into, 0.022, 0.006, self.lower))
        self._add("mouthShrugUpper", self._muscle(top, nose, 0.025, 0.006, upper))
        self._add("mouthShrugLower", self._muscle(bottom, nose, 0.03, 0.007, self.lower))

    def _side(self, side: int, suffix: str) -> None:
        """Expressions of one half: `side` is 1 on the subject's left."""
        u, marks, left = self.unit, self.marks, side > 0
        upper, outward = 1 - self.lower, np.array([side, 0.0, 0.0])
        corner, jaw = marks[54 if left else 48], marks[11 if left else 5]
        eye = marks[45 if left else 36]
        cheek = 0.5 * (eye + marks[14 if left else 2])
        low, high = marks[56 if left else 58], marks[52 if left else 50]
        brow = marks[22:27] if left else marks[17:22][::-1]

        def add(name: str, *muscle: Any) -> None:
            self._add(name + suffix, self._muscle(*muscle))

        add("mouthSmile", corner, cheek + [0, 0.01 * u, 0], 0.045, 0.014)
        add("mouthDimple", corner, corner + u * (0.03 * outward - [0, 0, 0.03]), 0.03, 0.008)
        add("mouthStretch", corner, jaw + 0.01 * u * outward, 0.042, 0.011)
        add(
            "mouthFrown", corner, corner + u * np.array([0.004 * side, -0.03, -0.005]), 0.035, 0.009
        )
        down = u * np.array([0.008 * side, -0.04, 0])
        add("mouthLowerDown", low, low + down, 0.028, 0.009, self.lower)
        add("mouthUpperUp", high, cheek, 0.028, 0.008, upper)
        press = u * np.array([0, 0.03, -0.01])
        add("mouthPress", low, low + press, 0.02, 0.003, self.lower)
        add("mouthPress", high, high + press * [1, -1, 1], 0.02, 0.003, upper)
        nose = marks[35 if left else 31]
        add("noseSneer", nose, nose + u * np.array([0.006 * side, 0.03, -0.01]), 0.03, 0.006, upper)
        puffed = self._falloff(0.5 * (corner + jaw) + [0, 0.01 * u, 0], 0.04)
        self._add(f"cheekPuff{suffix}", puffed[:, None] * [0.0064 * side * u, 0, 0.0048 * u])
        lift = u * np.array([0, 0.04, -0.012])
        add("browInnerUp", brow[0], brow[0] + lift, 0.035, 0.008)
        add("browOuterUp", brow[3], brow[3] + lift, 0.035, 0.008)
        add("browDown", brow[1], marks[27], 0.035, 0.008)
        add("cheekSquint", cheek, eye, 0.035, 0.005)
        add("cheekRaiser", cheek, eye, 0.03, 0.006)
        self._lids(marks[42:48] if left else marks[36:42], suffix)

    def _lids(self, eye: Points, suffix: str) -> None:
        upper, lower = eye[[1, 2]].mean(axis=0), eye[[4, 5]].mean(axis=0)
        gap, width = np.linalg.norm(upper - lower), float(np.linalg.norm(eye[0] - eye[3]))
        above = step((self.vertices[:, 1] - eye.mean(axis=0)[1] + 0.1 * gap) / (0.3 * gap))
        reach = [0.65 * width / self.unit / self.style.radius, 0.014, 0.03]
        top = (self._falloff(upper, reach) * above)[:, None] * (lower - upper)
        bottom = (self._falloff(lower, reach) * (1 - above))[:, None] * (lower - upper)
        self._add(f"eyeBlink{suffix}", 0.85 * top - 0.12 * bottom)
        self._add(f"eyeWide{suffix}", -0.25 * top)
        self._add(f"eyeSquint{suffix}", 0.25 * top - 0.35 * bottom)


def mhr(folder: Path) -> tuple[Points, npt.NDArray[Any], npt.NDArray[Any]]:
    """MHR's head: vertices (V, 3) m with the landmarks' mean at the origin, faces, landmarks (68,)."""
    with np.load(folder / "mhr_head" / "mhr_head.npz") as data:
        vertices, landmarks = data["neutral"].astype(np.float64) / 100, data["landmarks68"]
        return vertices - vertices[landmarks].mean(axis=0), data["faces"].astype(int), landmarks


def ict(_: Path) -> tuple[Points, npt.NDArray[Any], npt.NDArray[Any]]:
    """A drawn identity of the built-in face, with sockets."""
    model, count = load_face_model(), EXTENTS["sockets"]
    weights = 0.9 * np.random.default_rng(5).standard_normal(len(model.identity_basis))
    vertices = model.neutral[:count].astype(np.float64)
    vertices += np.tensordot(weights, model.identity_basis[:, :count], axes=1)
    vertices -= vertices[model.landmarks68].mean(axis=0)
    return vertices, triangulate(crop_quads(model, "sockets")).astype(int), model.landmarks68


Head = Callable[[Path], tuple[Points, npt.NDArray[Any], npt.NDArray[Any]]]
RIGS: dict[str, tuple[Head, Style]] = {
    "mhr": (mhr, Style()),
    "mhr-wide": (mhr, Style(size=1.1, radius=1.3, edge=1.5, jaw=1.6, neck_m=0.05)),
    "ict": (ict, Style(size=0.9, radius=0.8, jaw=0.7)),
}


def performances(corpus: Dataset, every: int) -> npt.NDArray[np.float32]:
    """(T, E) weights: the range of motion and held-out takes, every so many frames."""
    held_out = [s for s in corpus.sequences("test") if s.source not in ("rom", "rest")]
    chosen = np.random.default_rng(3).permutation(len(held_out))[:8]
    takes = [s for s in corpus.sequences() if s.source == "rom"]
    takes += [held_out[number] for number in chosen]
    return np.concatenate([corpus.weights(take)[::every] for take in takes])


def scores(
    output: Points, true: Points, vertices: Points, landmarks: npt.NDArray[Any]
) -> dict[str, float]:
    """What the module's docstring says."""
    marks = vertices[landmarks]
    near = cKDTree(marks).query(vertices)[0] < 0.045
    front = near & (vertices[:, 2] > marks[[0, 16], 2].min())
    lips = cKDTree(marks[48:60]).query(vertices)[0] < 0.006
    error, motion = (np.linalg.norm(x, axis=-1).sum(axis=0) for x in (output - true, true))
    parts = {"all": slice(None), "front": front, "lips": lips, "landmarks": landmarks}
    found = {name: float(error[part].sum() / motion[part].sum()) for name, part in parts.items()}
    return {**found, "slope": float((output * true).sum() / np.square(true).sum())}


def measure(model: Stm, rig: MuscleRig, true: Points) -> dict[str, dict[str, float]]:
    """Scores by how the landmarks are known."""
    options, vertices = model.options, rig.vertices
    operators = surface_operators(
        vertices / options.length_scale, rig.faces, k=options.k_eig, cache=False
    ).to(dtype=torch.float32)
    features = model.encode(torch.from_numpy(vertices).float(), operators)
    landmarks = torch.from_numpy(true[:, rig.landmarks].astype(np.float32))
    plain = model.frame_decoder(features, operators).decode(landmarks)
    face = built_in_face()
    mean = np.asarray(face.neutral, np.float64)
    outward = vertex_normals(mean, face.faces)[face.landmarks]
    found = {"plain": scores(plain.numpy(), true, vertices, rig.landmarks)}
    for name, places, wanted in (
        ("known", rig.marks, FollowOptions()),
        ("guessed", mean[face.landmarks], FollowOptions(noise=GUESSED_NOISE, guessed=True)),
    ):
        follower = LandmarkFollower(
            vertices, rig.faces, landmarks=places, normals=outward, options=wanted
        )
        moved = follower.apply(plain, landmarks)
        found[name] = scores(moved.numpy(), true, vertices, rig.landmarks)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--corpus", type=Path, required=True, help="folder of the open corpus")
    parser.add_argument("--data", type=Path, required=True, help="folder that holds mhr_head")
    parser.add_argument("--pretrained", type=Path, default=SHIPPED, help="folder of the weights")
    parser.add_argument("--rigs", nargs="+", choices=RIGS, default=list(RIGS))
    parser.add_argument("--every", type=int, default=150, help="frames from one to the next")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    arguments = parser.parse_args()
    corpus = open_dataset(arguments.corpus)
    weights = performances(corpus, arguments.every)
    model = Stm.from_pretrained(arguments.pretrained / "stm").eval()
    results: dict[str, Any] = {}
    rows = [("rig", "landmarks", "all", "front", "lips", "at landmarks", "slope")]
    for name in arguments.rigs:
        make, style = RIGS[name]
        rig = MuscleRig(*make(arguments.data), style)
        true = np.tensordot(weights, rig.basis(corpus.expressions), axes=1)
        with torch.no_grad():
            results[name] = measure(model, rig, true)
        for known, row in results[name].items():
            rows.append((name, known, *(f"{value:.3f}" for value in row.values())))
    print(f"{arguments.pretrained}: {len(weights)} frames")
    print(plain_table(rows))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
