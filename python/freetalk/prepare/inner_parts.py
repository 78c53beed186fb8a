"""Teeth, gums, tongue and eyeballs for a face that has none: those of the built-in face, fitted to its openings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freetalk import geometry
from freetalk.corpus.assets import load_face_model
from freetalk.geometry import Similarity
from freetalk.mesh import Mesh
from freetalk.prepare.repair import Prepared, polygons_of
from freetalk.viz.appearance import GUMS, IRIS, IVORY, MOUTH_INSIDE, PUPIL
from freetalk.viz.cavities import Eye, find_cavities

Points = NDArray[np.float64]

#: Vertices of the built-in face by part.
_CAVITY, _GUMS, _TEETH, _EYEBALL = (11248, 13294), (14062, 17039), (17039, 21451), (21451, 23021)
_EYEBALL_CENTER_M, _EYEBALL_RADIUS_M = np.array([0.0312, 0.0386, -0.0145]), 0.0158
_INNER_LIPS, _CORNERS = slice(60, 68), (48, 54)
#: The front of the teeth stays so far (m) behind the skin before it; they shrink and recede up to these for it.
_BEHIND_M, _RECEDE_M, _SHRINK, _ROUNDS = 0.002, 0.012, 0.95, 8
#: The skin before a point is that within this (m) of it as seen from the front, of the skin around the lips.
_BESIDE_M, _AROUND_M, _SAMPLES = 0.002, 0.05, 30_000
_MATERIALS = {
    "teeth": IVORY,
    "gums": GUMS,
    "mouth": MOUTH_INSIDE,
    "eye": IVORY,
    "iris": IRIS,
    "pupil": PUPIL,
}
_IRIS_COSINE, _PUPIL_COSINE = np.cos(np.deg2rad(28.0)), np.cos(np.deg2rad(11.0))


@dataclass(frozen=True)
class _Piece:
    """A part of the built-in face: points (N, 3) m, polygons and the material of each."""

    points: Points
    polygons: list[list[int]]
    materials: list[str]


def add_inner_parts(prepared: Prepared, pose: Similarity, landmarks: Points) -> Prepared:
    """Puts eyeballs behind lids that are holes, and teeth, gums, tongue and a dark cavity behind lips that are one.

    The talker moves them as those of any head: upper teeth stay, lower ones and the tongue go with the jaw.

    Args:
        prepared: polygons that face outward; the lips apart, without an inner mouth.
        pose: from the mesh to the canonical frame, m.
        landmarks: (68, 3) in the mesh's own unit and axes.

    Returns:
        The mesh with the parts behind its own vertices and polygons; as it was where there is no such opening.
    """
    mesh, marks = prepared.mesh, pose.apply(np.asarray(landmarks, dtype=np.float64))
    home = pose.apply(np.asarray(mesh.vertices))
    openings = find_cavities(home.astype(np.float32), np.asarray(mesh.faces, np.int64))
    pieces = [_eyeball(eye) for eye in openings.eyes]
    steps = [f"{len(pieces)} eyeballs added"] if pieces else []
    if openings.mouth is not None:
        mouth = _mouth(marks, home, np.asarray(mesh.faces))
        steps.append(
            "no teeth added: there is too little room behind the lips"
            if mouth is None
            else "teeth, gums and tongue added"
        )
        pieces += [] if mouth is None else [mouth]
    else:
        steps.append("no teeth added: the mouth is no opening")
    if not pieces:
        return Prepared(mesh, prepared.vertex_map, [*prepared.steps, *steps], prepared.appearance)
    polygons = polygons_of(mesh)
    corners = [list(polygon) for polygon in mesh.polygon_texcoords]
    vertices, names = [np.asarray(mesh.vertices, dtype=np.float64)], list(_MATERIALS)
    look: list[int] = []
    own = len(polygons)
    for piece in pieces:
        first = sum(map(len, vertices))
        vertices.append(pose.inverse().apply(piece.points))
        polygons += [[first + vertex for vertex in polygon] for polygon in piece.polygons]
        look += [names.index(material) for material in piece.materials]
    if len(mesh.texcoords):
        corners += [[] for _ in look]
    colours = [(name, np.asarray(colour) ** 2.2) for name, colour in _MATERIALS.items()]
    added = sum(map(len, vertices[1:]))
    return Prepared(
        Mesh(
            np.concatenate(vertices),
            polygons,
            texcoords=mesh.texcoords,
            polygon_texcoords=corners,
            name=mesh.name,
        ),
        prepared.vertex_map,
        [*prepared.steps, *steps],
        prepared.appearance.with_parts(own, colours, look, added),
    )


def _piece(bounds: tuple[int, int], material: str) -> _Piece:
    """A range of the built-in face's vertices and the polygons among them."""
    model, (first, last) = load_face_model(), bounds
    rows = np.where(model.quads < 0, first, model.quads)
    inside = ((rows >= first) & (rows < last)).all(axis=1)
    polygons = [[int(v) - first for v in row if v >= 0] for row in model.quads[inside]]
    points = model.neutral[first:last].astype(np.float64)
    return _Piece(points, polygons, [material] * len(polygons))


def _eyeball(eye: Eye) -> _Piece:
    """The built-in face's eyeball as an eye that looks along +Z."""
    ball = _piece(_EYEBALL, "eye")
    own = (ball.points - _EYEBALL_CENTER_M) / _EYEBALL_RADIUS_M
    ahead = np.array([own[polygon, 2].mean() for polygon in ball.polygons])
    names = np.select([ahead > _PUPIL_COSINE, ahead > _IRIS_COSINE], ["pupil", "iris"], "eye")
    return _Piece(eye.center + eye.radius * own, ball.polygons, names.tolist())


def _mouth(marks: Points, home: Points, faces: NDArray[np.int32]) -> _Piece | None:
    """Teeth, gums, tongue and the cavity around them behind the lips; None where they do not fit."""
    from scipy.spatial import cKDTree

    model = load_face_model()
    usual = model.neutral[model.landmarks68].astype(np.float64)
    width = [np.linalg.norm(points[_CORNERS[0]] - points[_CORNERS[1]]) for points in (marks, usual)]
    lips, usual_lips = marks[_INNER_LIPS].mean(axis=0), usual[_INNER_LIPS].mean(axis=0)
    pieces = [_piece(_TEETH, "teeth"), _piece(_GUMS, "gums"), _piece(_CAVITY, "mouth")]
    scale, back = float(np.clip(width[0] / width[1], 0.6, 1.6)), 0.0
    around = np.abs(home[faces].mean(axis=1)[:, 1] - lips[1]) < _AROUND_M
    skin_points, _ = geometry.sample_template(home, faces[around], _SAMPLES)
    seen = cKDTree(skin_points[:, :2])
    teeth = pieces[0].points - usual_lips
    for _ in range(_ROUNDS):
        placed = lips + scale * teeth
        skin = seen.query_ball_point(placed[:, :2], _BESIDE_M)
        room = (
            np.array([skin_points[beside, 2].max() if beside else np.inf for beside in skin])
            - placed[:, 2]
        )
        back = max(0.0, _BEHIND_M - float(room.min()))
        if back <= _RECEDE_M:
            break
        scale *= _SHRINK
    else:
        return None
    shift = lips - np.array([0.0, 0.0, back])
    points: list[Points] = []
    polygons, materials = [], []
    for piece in pieces:
        first = sum(map(len, points))
        points.append(shift + scale * (piece.points - usual_lips))
        polygons += [[first + vertex for vertex in polygon] for polygon in piece.polygons]
        materials += piece.materials
    return _Piece(np.concatenate(points), polygons, materials)
