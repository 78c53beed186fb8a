#!/usr/bin/env python3
"""Finds where MediaPipe's 468 face points lie on the built-in face, for `freetalk mesh landmarks`.

    scripts/pack_face_points.py ../shared/data/mediapipe_canonical [--faces 60]

Identities of the built-in face are drawn and looked at from several sides as any other mesh is; each point goes to the
place of the mean face where it is found on average. The deviation is measured on as many other identities.
MediaPipe's canonical face (Apache-2.0) serves as the first guess of where they are.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from freetalk._files import replacing
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.faces.detector import NUM_POINTS, detector
from freetalk.faces.points import FILE, FacePoints, eye_distance
from freetalk.faces.sighting import fit_pose, observe
from freetalk.faces.views import SurfaceViews
from freetalk.geometry import Similarity

_SEED, _SPREAD = 7, 0.9


def first_guess(folder: Path, landmarks: np.ndarray) -> np.ndarray:
    """(468, 3) MediaPipe's canonical face, laid onto the mean face's landmarks."""
    lines = (folder / "canonical_face_model.obj").read_text().splitlines()
    points = np.array([[float(x) for x in line.split()[1:4]] for line in lines if line[:2] == "v "])
    chosen = json.loads((folder / "landmarks68.json").read_text())
    return fit_pose(points[chosen], landmarks, np.ones(68)).apply(points)


def sightings(count: int, reference: np.ndarray, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(vertices, points found) of drawn identities, half of them with eyeballs and teeth."""
    model = load_face_model()
    rng = np.random.default_rng(seed)
    num_shaped = model.identity_basis.shape[1]
    result = []
    for number in range(count):
        extent = "full" if number % 2 else "sockets"
        vertices = model.neutral[: EXTENTS[extent]].astype(np.float64)
        weights = rng.normal(0, _SPREAD, len(model.identity_basis))
        vertices[:num_shaped] += np.tensordot(weights, model.identity_basis, axes=1)
        with SurfaceViews(vertices, triangulate(crop_quads(model, extent))) as views:
            eyes = eye_distance(vertices[model.landmarks68])
            found = observe(views, detector(), Similarity(), reference, eyes)
        if found is not None:
            result.append((vertices[:num_shaped], found.points))
    return result


def embed(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (N, 3) and barycentric weights (N, 3) of the mean face's skin nearest to points (N, 3)."""
    import pyvista

    model = load_face_model()
    faces = triangulate(crop_quads(model, "face"))
    skin = pyvista.PolyData.from_regular_faces(model.neutral.astype(np.float64), faces)
    cells, nearest = skin.find_closest_cell(points, return_closest_point=True)
    corners = model.neutral[faces[cells]].astype(np.float64)  # (N, 3, 3)
    sides = corners[:, 1:] - corners[:, :1]
    shares = np.stack(
        [
            np.linalg.lstsq(side.T, point - corner, rcond=None)[0]
            for side, point, corner in zip(sides, nearest, corners[:, 0])
        ]
    )
    weights = np.clip(np.column_stack([1 - shares.sum(axis=1), shares]), 0, 1)
    return faces[cells], weights / weights.sum(axis=1, keepdims=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("canonical", type=Path)
    parser.add_argument("--faces", type=int, default=60)
    arguments = parser.parse_args()
    model = load_face_model()
    mean = model.neutral.astype(np.float64)
    reference = first_guess(arguments.canonical, mean[model.landmarks68])
    places = np.zeros((0, NUM_POINTS, 3))
    for vertices, found in sightings(arguments.faces, reference, _SEED):
        # Carried to the mean face by the displacement of the nearest skin.
        skin = vertices[: EXTENTS["face"]]
        near = np.stack([np.square(skin - point).sum(axis=1).argsort()[:4] for point in found])
        places = np.concatenate(
            [places, (found + (mean[near] - vertices[near]).mean(axis=1))[None]]
        )
    triangles, weights = embed(np.median(places, axis=0))
    points = FacePoints(triangles, weights, np.zeros(NUM_POINTS))
    errors = [
        np.linalg.norm(found - points.of(vertices), axis=1)
        / eye_distance(vertices[model.landmarks68])
        for vertices, found in sightings(arguments.faces, reference, _SEED + 1)
    ]
    deviation = np.sqrt(np.square(errors).mean(axis=0))
    with replacing(FILE) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            vertices=triangles.astype(np.uint16),
            weights=weights.astype(np.float32),
            deviation=deviation.astype(np.float32),
        )
    print(
        f"wrote {FILE}: {len(places)} and {len(errors)} faces, deviation mean {deviation.mean():.4f}, "
        f"largest {deviation.max():.4f} of the distance between the eyes' outer corners"
    )


if __name__ == "__main__":
    main()
