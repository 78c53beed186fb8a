#!/usr/bin/env python3
"""Measures whether lips and lids that touch in the motion touch on heads of other proportions.

    python scripts/bench/contact.py --data ../shared/data
    python scripts/bench/contact.py --data ../shared/data --heads wide mhr --plain --out contact.json

The shipped weights speak; of their landmark motion the closures (inner lips at most 0.3 mm farther apart than those of
the mean face at rest) and the blinks (lids at most 7 % open) are decoded on each head: the mean face, six of its
identities pushed to extremes, a drawn one, one of few vertices, and two of other topologies. In planes
through the pairs of inner-lip and lid landmarks, and halfway between neighbours, the surface of either side
within 5 mm of the landmark is sampled every 0.1 mm, and followed:

    gap     least distance of the two sides, mm
    depth   how far one side is behind the other, mm

A closure counts with the plane where it is worst. Landmarks are "known" (those of the head) or "guessed" (where the
mean face has them); `--plain` shows the motion as it is made for the mean face.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvista
import torch
from scipy.spatial import cKDTree

import freetalk
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, speech_clip, triangulate
from freetalk.evaluate.writers import plain_table
from freetalk.geometry import surface_operators
from freetalk.mesh import vertex_normals
from freetalk.stm import FollowOptions, LandmarkCarrier, LandmarkFollower, Stm

Points = npt.NDArray[np.float64]
Head = tuple[Points, npt.NDArray[Any], Points]
SHIPPED = Path(freetalk.__file__).parent / "pretrained" / "open-small"
LIPS, LIDS = ((61, 67), (62, 66), (63, 65)), ((37, 41), (38, 40), (43, 47), (44, 46))
CLOSED_M, BLINK = 3e-4, 0.07
REACH_M, STEP_M = 5e-3, 1e-4
GUESSED_NOISE = 0.05


def heads(data: Path) -> dict[str, Head]:
    """Vertices (V, 3) m with the landmarks' mean at the origin, faces (F, 3), landmarks (68, 3)."""
    model, count = load_face_model(), EXTENTS["sockets"]
    basis = model.identity_basis[:, model.landmarks68].astype(np.float64)
    faces = triangulate(crop_quads(model, "sockets")).astype(np.int64)
    size = {
        "mouth": basis[:, 54, 0] - basis[:, 48, 0],
        "lips": basis[:, 51, 1] - basis[:, 62, 1] + basis[:, 66, 1] - basis[:, 57, 1],
        "eyes": basis[:, 37, 1] - basis[:, 41, 1] + basis[:, 44, 1] - basis[:, 46, 1],
    }

    def ict(weights: Points) -> Head:
        moved = np.tensordot(weights, model.identity_basis[:, :count].astype(np.float64), axes=1)
        vertices = model.neutral[:count] + moved
        return vertices, faces, vertices[model.landmarks68]

    def pushed(what: str, deviations: float) -> Head:
        return ict(deviations * size[what] / np.linalg.norm(size[what]))

    found = {
        "mean": ict(np.zeros(len(basis))),
        "wide": pushed("mouth", 3),
        "narrow": pushed("mouth", -3),
        "thick": pushed("lips", 3),
        "thin": pushed("lips", -2.5),
        "eyes": pushed("eyes", 3),
        "slits": pushed("eyes", -3),
        "drawn": ict(1.2 * np.random.default_rng(0).standard_normal(len(basis))),
    }
    vertices, _, landmarks = found["drawn"]
    whole = pyvista.PolyData.from_regular_faces(vertices, faces)
    few = whole.decimate(0.8)
    found["few"] = (
        np.asarray(few.points, np.float64),
        few.regular_faces.astype(np.int64),
        landmarks,
    )
    with np.load(data / "mhr_head" / "mhr_head.npz") as mhr:
        vertices = mhr["neutral"].astype(np.float64) / 100
        found["mhr"] = (vertices, mhr["faces"].astype(np.int64), vertices[mhr["landmarks68"]])
    folder = data / "mediapipe_canonical"
    mesh: Any = freetalk.load_mesh(folder / "canonical_face_model.obj")
    vertices = np.asarray(mesh.vertices) / 100
    marks = vertices[json.loads((folder / "landmarks68.json").read_text())]
    found["mediapipe"] = (vertices, np.asarray(mesh.faces).astype(np.int64), marks)
    return {name: (v - m.mean(axis=0), f, m - m.mean(axis=0)) for name, (v, f, m) in found.items()}


@dataclass(frozen=True)
class Side:
    """Samples of one side of a gap: corners (S, 3) of their triangles, shares (S, 3)."""

    corners: npt.NDArray[np.int64]
    shares: Points

    def at(self, vertices: Points) -> Points:
        """(S, 2) y and z."""
        return np.asarray(np.einsum("sk,skd->sd", self.shares, vertices[self.corners])[:, 1:])

    def outward(self, vertices: Points) -> Points:
        """(S, 2) y and z of the unit normals."""
        a, b, c = vertices[self.corners].transpose(1, 0, 2)
        normals = np.cross(b - a, c - a)
        size = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.asarray((normals / np.maximum(size, 1e-15))[:, 1:])


def side_of(vertices: Points, triangles: npt.NDArray[Any], landmark: Points, x: float) -> Side:
    """What of triangles the plane of an x cuts within reach of a landmark."""
    over = vertices[triangles][..., 0] - x
    corners, shares = [], []
    for triangle, height in zip(triangles, over):
        ends = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            if (height[a] < 0) != (height[b] < 0):
                share = np.zeros(3)
                share[b] = height[a] / (height[a] - height[b])
                share[a] = 1 - share[b]
                ends.append(share)
        if len(ends) < 2:
            continue
        length = np.linalg.norm((ends[1] - ends[0]) @ vertices[triangle])
        along = np.linspace(0, 1, int(length / STEP_M) + 2)[:, None]
        samples = (1 - along) * ends[0] + along * ends[1]
        near = np.linalg.norm(samples @ vertices[triangle] - landmark, axis=1) < REACH_M
        corners += [triangle] * int(near.sum())
        shares.append(samples[near])
    return Side(np.array(corners, np.int64).reshape(-1, 3), np.concatenate(shares or [over[:0]]))


def gaps_of(head: Head, pairs: tuple[tuple[int, int], ...]) -> list[tuple[Side, Side]]:
    """The two sides in the plane of each pair, and halfway to the next."""
    vertices, faces, marks = head
    normals = np.zeros((68, 3))
    weights = np.asarray(
        LandmarkFollower(vertices, faces, landmarks=marks, normals=normals).weights
    )
    uppers, lowers = zip(*pairs)
    upper = weights[:, uppers].max(axis=1) > weights[:, lowers].max(axis=1)
    count = upper[faces].sum(axis=1)
    places = [(marks[a], marks[b]) for a, b in pairs]
    middles = zip(places, places[1:])  # between the eyes there are no two sides
    places += [((a + c) / 2, (b + d) / 2) for (a, b), (c, d) in middles]
    found = []
    for top, bottom in places:
        x = float(top[0] + bottom[0]) / 2
        sides = (
            side_of(vertices, faces[count == 3], top, x),
            side_of(vertices, faces[count == 0], bottom, x),
        )
        if all(len(side.corners) for side in sides):
            found.append(sides)
    return found


def touch(vertices: Points, sides: tuple[Side, Side]) -> tuple[float, float]:
    """Gap and depth, mm."""
    upper, lower = (side.at(vertices) for side in sides)
    distance, nearest = cKDTree(upper).query(lower)
    height = ((lower - upper[nearest]) * sides[0].outward(vertices)[nearest]).sum(axis=1)
    behind = (height < -0.7 * distance) & (distance < 3e-3)
    return 1e3 * distance.min(), 1e3 * distance[behind].max(initial=0.0)


def spoken(talker: freetalk.Talker, head: Head, clip: Path) -> tuple[Points, Points]:
    """Closures and blinks (T, 68, 3) of what the talker says, made for the mean face."""
    mesh = freetalk.Mesh(head[0], head[1].tolist(), name="mean")
    spoken_clip = talker.prepare(mesh, landmarks=head[2]).animate(clip, progress=False)
    motion = np.asarray(spoken_clip.landmarks, np.float64)
    lips = np.flatnonzero(motion[:, 62, 1] - motion[:, 66, 1] <= CLOSED_M)
    marks = head[2]
    eye = marks[37, 1] - marks[41, 1]
    lids = np.flatnonzero(1 + (motion[:, 37, 1] - motion[:, 41, 1]) / eye < BLINK)
    return motion[lips[:: max(1, len(lips) // 40)]], motion[lids]


def measure(
    model: Stm, head: Head, mean: Head, known: bool, plain: bool, motion: tuple[Points, Points]
) -> dict[str, float]:
    """Scores of one head; see the module's docstring."""
    vertices, faces, _ = head
    options = model.options
    operators = surface_operators(
        vertices / options.length_scale, faces, k=options.k_eig, cache=False
    ).to(dtype=torch.float32)
    outward = vertex_normals(mean[0], mean[1])[load_face_model().landmarks68]
    marks, noise = (head[2], FollowOptions().noise) if known else (mean[2], GUESSED_NOISE)
    follower = LandmarkFollower(
        vertices,
        faces,
        landmarks=marks,
        normals=outward,
        options=FollowOptions(noise=noise, guessed=not known),
    )
    features = model.encode(torch.from_numpy(vertices).float(), operators)
    decoder = model.frame_decoder(features, operators, follower=follower)
    carrier = LandmarkCarrier(
        vertices, faces, follower=follower, mean=mean[2], known=known, decoder=decoder
    )

    def scores(pairs: Any, made: Points) -> Points:
        landmarks = torch.from_numpy(made).float()
        moved = decoder.decode(landmarks if plain else carrier.apply(landmarks)).numpy()
        sides = gaps_of(head, pairs)
        return np.array([[touch(vertices + frame, each) for each in sides] for frame in moved])

    lips, lids = scores(LIPS, motion[0]), scores(LIDS, motion[1])
    lip_gaps, lip_depths = lips.max(axis=1).T
    return {
        "lips_gap_95": float(np.quantile(lip_gaps, 0.95)),
        "lips_within_half_mm": float((lip_gaps <= 0.5).mean()),
        "lips_depth_95": float(np.quantile(lip_depths, 0.95)),
        "lids_gap": float(lids[..., 0].max()),
        "lids_depth": float(lids[..., 1].max()),
    }


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--pretrained", type=Path, default=SHIPPED)
    parser.add_argument("--audio", type=Path, default=speech_clip())
    parser.add_argument("--heads", nargs="+")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    all_heads = heads(arguments.data)
    mean = all_heads["mean"]
    motion = spoken(freetalk.Talker.from_pretrained(arguments.pretrained), mean, arguments.audio)
    print(f"{len(motion[0])} closures, {len(motion[1])} frames of blinks", flush=True)
    model = Stm.from_pretrained(arguments.pretrained / "stm").eval()
    rows = []
    for name in arguments.heads or all_heads:
        for known in (True, False):
            found = measure(model, all_heads[name], mean, known, arguments.plain, motion)
            row: dict[str, Any] = {"head": name, "landmarks": "known" if known else "guessed"}
            rows.append(row | found)
            print(json.dumps(rows[-1]), flush=True)
    columns = list(rows[0])
    texts = [[c if isinstance(c, str) else f"{c:.2f}" for c in row.values()] for row in rows]
    print(plain_table([columns, *texts]))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
