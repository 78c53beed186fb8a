"""A scan made ready to speak: duplicates, floating bits, winding, small holes, lips that are one skin; each step
optional and reported."""

from __future__ import annotations

import os
from collections import defaultdict, deque
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from freetalk.animation import Animation
from freetalk.geometry import Similarity
from freetalk.mesh import (
    Appearance,
    Mesh,
    Reshaped,
    SlitOptions,
    boundary_loops,
    connected_components,
    cut_lips,
    lips_are_joined,
    load_appearance,
    load_mesh,
    save_mesh,
    to_vertex_budget,
)
from freetalk.viz.appearance import MOUTH_INSIDE

#: A part with less than this share of the polygons floats beside the face by mistake.
FLOATING = 0.002
#: Landmarks around which a vertex budget goes first: how much more edges are worth there, and how far from them (m).
IMPORTANT = ((slice(0, 68), 1.5, 0.04), (slice(36, 68), 3.0, 0.012))

Polygon = list[int]


@dataclass(frozen=True)
class Prepared:
    """A repaired mesh.

    Attributes:
        mesh: with the vertices that are left in their order and place, then those of closed holes, of the slit and of
            the inner mouth.
        vertex_map: (V,) the new vertex of each old one, -1 where it is gone.
        steps: one line for each repair that changed something.
        appearance: materials, textures and colours of the file that the mesh was read from, on the new mesh.
    """

    mesh: Mesh
    vertex_map: NDArray[np.int64]
    steps: list[str]
    appearance: Appearance


def prepare_mesh(
    mesh: Mesh,
    *,
    duplicates: bool = True,
    floating: float = FLOATING,
    winding: bool = True,
    holes: int = 0,
) -> Prepared:
    """Repairs a mesh; texture coordinates and the look of the surface are kept.

    Args:
        mesh: any polygons.
        duplicates: drop polygons with the vertices of an earlier one, and those with fewer than three corners.
        floating: drop parts with less than this share of the polygons; 0 keeps all.
        winding: turn polygons so that neighbours agree and every part faces outward.
        holes: close holes of at most this many edges; 0 closes none. Eyes, mouth and neck are holes too.

    Raises:
        ValueError: an option is out of range, or nothing would be left.
    """
    if not 0 <= floating < 1 or holes < 0:
        raise ValueError(
            f"floating must be in [0, 1) and holes 0 or more, found {floating} and {holes}"
        )
    look = load_appearance(mesh)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    polygons = polygons_of(mesh)
    corners: list[Polygon] = [list(p) for p in mesh.polygon_texcoords] or [[] for _ in polygons]
    origin = list(range(len(polygons)))
    place = places_of(vertices)
    steps: list[str] = []
    if duplicates:
        kept = _single(polygons)
        steps += _said(len(polygons) - len(kept), "duplicate or collapsed polygons dropped")
        polygons, corners = [polygons[k] for k in kept], [corners[k] for k in kept]
        origin = [origin[k] for k in kept]
    if floating > 0 and polygons:
        part = _parts(polygons, place)
        share = np.bincount(part) / len(part)
        kept = [k for k, number in enumerate(part) if share[number] >= floating]
        gone = int((share[np.unique(part)] < floating).sum())
        steps += _said(gone, f"floating parts dropped ({len(polygons) - len(kept)} polygons)")
        polygons, corners = [polygons[k] for k in kept], [corners[k] for k in kept]
        origin = [origin[k] for k in kept]
    if not polygons:
        raise ValueError(f"{mesh.name}: no polygon is left; allow smaller parts")
    if winding:
        turned = _to_turn(vertices, polygons, place)
        for k in np.flatnonzero(turned):
            polygons[k].reverse()
            corners[k].reverse()
        steps += _said(int(turned.sum()), "polygons turned outward")
    added = np.zeros((0, 3))
    if holes > 0:
        loops = [loop for loop in _rims(polygons, place) if len(loop) <= holes]
        added = np.array([vertices[loop].mean(axis=0) for loop in loops]).reshape(-1, 3)
        for number, loop in enumerate(loops):
            center = len(vertices) + number
            fan = [[b, a, center] for a, b in zip(loop, loop[1:] + loop[:1])]
            polygons += fan
            corners += [[] for _ in fan]
            origin += [-1] * len(fan)
        steps += _said(len(loops), "holes closed")
    used = np.zeros(len(vertices) + len(added), dtype=bool)
    used[np.concatenate([np.asarray(polygon) for polygon in polygons])] = True
    steps += _said(int((~used[: len(vertices)]).sum()), "vertices without a polygon dropped")
    new = np.where(used, np.cumsum(used) - 1, -1)
    repaired = Mesh(
        np.concatenate([vertices, added])[used],
        [new[polygon].tolist() for polygon in polygons],
        texcoords=mesh.texcoords,
        polygon_texcoords=corners if len(mesh.texcoords) else [],
        name=mesh.name,
    )
    colours = np.asarray(look.colours)
    if len(colours):
        colours = np.concatenate([colours, np.ones((len(added), 4))])[used]
    appearance = look.carried(origin, colours)
    return Prepared(repaired, new[: len(vertices)].astype(np.int64), steps, appearance)


def to_budget(
    prepared: Prepared,
    vertices: int,
    pose: Similarity | None = None,
    landmarks: NDArray[np.float64] | None = None,
) -> Prepared:
    """Thins a mesh out or refines it to about as many vertices, most of them around mouth and eyes.

    Args:
        prepared: as :func:`prepare_mesh` leaves it.
        vertices: how many are wanted, > 0.
        pose: from the mesh to the canonical frame, m; None: the same everywhere.
        landmarks: (68, 3) in the mesh's own unit and axes.

    Raises:
        ValueError: no vertices are wanted.
    """
    mesh = prepared.mesh
    importance = np.ones(len(mesh.vertices))
    if pose is not None and landmarks is not None:
        home, marks = pose.apply(np.asarray(mesh.vertices)), pose.apply(landmarks)
        for rows, worth, reach in IMPORTANT:
            away = cKDTree(marks[rows]).query(home)[0]
            importance += worth * np.exp(-((away / reach) ** 2))
    made = to_vertex_budget(mesh, vertices, importance)
    count = len(made.mesh.vertices)
    if count == len(mesh.vertices):
        return prepared
    now = np.asarray(made.vertex_map)
    colours = np.asarray(prepared.appearance.colours)
    if len(colours):
        mixed = _mixed(colours, made)
        colours = np.concatenate([mixed[: len(now)][now >= 0], mixed[len(now) :]])
    look = prepared.appearance.carried(made.polygon_origin, colours)
    old = prepared.vertex_map
    steps = [*prepared.steps, f"{len(mesh.vertices)} vertices made {count}"]
    return Prepared(made.mesh, np.where(old >= 0, now[old], -1), steps, look)


def open_lips(
    prepared: Prepared, pose: Similarity, landmarks: NDArray[np.float64], **options: float
) -> Prepared:
    """Cuts a slit between lips that are one closed skin, and sews an inner mouth to it; others stay as they are.

    Args:
        prepared: polygons that face outward, as :func:`prepare_mesh` leaves them.
        pose: from the mesh to the canonical frame, m.
        landmarks: (68, 3) in the mesh's own unit and axes.
        options: fields of ``SlitOptions``: edge, corridor, gap, depth (0: no inner mouth), m.

    Raises:
        ValueError: options or landmarks of another form.
        RuntimeError: the surface at the lips cannot be cut.
    """
    mesh, marks = prepared.mesh, pose.apply(np.asarray(landmarks, dtype=np.float64))
    home = pose.apply(np.asarray(mesh.vertices))
    if not lips_are_joined(home, np.asarray(mesh.faces), marks):
        return prepared
    wanted = SlitOptions(**options)
    upright = Mesh(
        home,
        polygons_of(mesh),
        texcoords=mesh.texcoords,
        polygon_texcoords=mesh.polygon_texcoords,
        name=mesh.name,
    )
    slit = cut_lips(upright, marks, options=wanted)
    vertices = pose.inverse().apply(np.asarray(slit.mesh.vertices))
    vertices[: len(home)] = mesh.vertices
    opened = Mesh(
        vertices,
        polygons_of(slit.mesh),
        texcoords=slit.mesh.texcoords,
        polygon_texcoords=slit.mesh.polygon_texcoords,
        name=mesh.name,
    )
    colours = _mixed(np.asarray(prepared.appearance.colours), slit)
    skin = len(slit.polygon_origin) - slit.pocket_polygons
    colours = colours[: len(vertices) - slit.pocket_vertices]
    look = prepared.appearance.carried(slit.polygon_origin[:skin], colours)
    if wanted.depth > 0:
        inside = [("mouth", np.asarray(MOUTH_INSIDE) ** 2.2)]
        look = look.with_parts(skin, inside, [0] * slit.pocket_polygons, slit.pocket_vertices)
    step = f"a slit of {slit.edges} edges cut between the lips"
    if wanted.depth > 0:
        step += ", an inner mouth sewn behind it"
    return Prepared(opened, prepared.vertex_map, [*prepared.steps, step], look)


def save_prepared(path: str | os.PathLike[str], prepared: Prepared) -> None:
    """Writes a mesh with its look: OBJ and PLY as they are, glTF with materials and textures inside.

    Args:
        path: .obj, .ply, .glb or .gltf; glTF keeps the numbers of the mesh, whose unit it calls a metre.
        prepared: what to write.

    Raises:
        RuntimeError: another extension, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in (".glb", ".gltf"):
        save_mesh(path, prepared.mesh, prepared.appearance)
        return
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"{path.stem}.obj"
        save_mesh(file, prepared.mesh, prepared.appearance)
        mesh = load_mesh(file)
        Animation(mesh, torch.zeros(1, len(mesh.vertices), 3)).save(path)


def polygons_of(mesh: Mesh) -> list[Polygon]:
    """Its polygons, the triangles where it has no others; lists of their own."""
    return [list(polygon) for polygon in mesh.polygons or np.asarray(mesh.faces).tolist()]


def _mixed(colours: NDArray[np.float64], made: Reshaped) -> NDArray[np.float64]:
    """(V', 4) those of the given vertices and of the new ones; (0, 4) without any."""
    rows = list(colours)
    if rows:
        for a, b, share in made.vertex_origin:
            rows.append((1 - share) * rows[a] + share * rows[b])
    return np.asarray(rows).reshape(-1, 4)


def _said(count: int, what: str) -> list[str]:
    return [f"{count} {what}"] if count else []


def places_of(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """(V,) a number for each position, so that vertices doubled along seams are one."""
    return np.unique(vertices, axis=0, return_inverse=True)[1].ravel().astype(np.int64)


def _single(polygons: list[Polygon]) -> list[int]:
    """Polygons of three corners and more whose vertices no earlier one has."""
    seen: set[tuple[int, ...]] = set()
    kept = []
    for k, polygon in enumerate(polygons):
        key = tuple(sorted(set(polygon)))
        if len(key) >= 3 and key not in seen:
            seen.add(key)
            kept.append(k)
    return kept


def _parts(polygons: list[Polygon], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """(P,) the connected part of each polygon."""
    fans = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    labels = connected_components(int(place.max()) + 1, place[np.asarray(fans)].astype(np.int32))
    return np.asarray(labels)[[place[polygon[0]] for polygon in polygons]].astype(np.int64)


def _directed(polygon: Polygon, place: NDArray[np.int64]) -> list[tuple[int, int]]:
    at = [int(place[vertex]) for vertex in polygon]
    return [(a, b) for a, b in zip(at, at[1:] + at[:1]) if a != b]


def _to_turn(
    vertices: NDArray[np.float64], polygons: list[Polygon], place: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """(P,) the polygons to turn around."""
    around: dict[tuple[int, int], list[tuple[int, bool]]] = defaultdict(list)
    for k, polygon in enumerate(polygons):
        for a, b in _directed(polygon, place):
            around[min(a, b), max(a, b)].append((k, a < b))
    neighbours: list[list[tuple[int, bool]]] = [[] for _ in polygons]
    for sides in around.values():
        if len(sides) == 2:
            (first, up), (second, down) = sides
            neighbours[first].append((second, up == down))
            neighbours[second].append((first, up == down))
    turn = np.zeros(len(polygons), dtype=bool)
    seen = np.zeros(len(polygons), dtype=bool)
    for start in range(len(polygons)):
        if seen[start]:
            continue
        seen[start] = True
        part, queue = [start], deque([start])
        while queue:
            current = queue.popleft()
            for other, opposed in neighbours[current]:
                if not seen[other]:
                    seen[other] = True
                    turn[other] = turn[current] ^ opposed
                    part.append(other)
                    queue.append(other)
        if _volume(vertices, [polygons[k] for k in part], turn[part]) < 0:
            turn[part] = ~turn[part]
    return turn


def _volume(
    vertices: NDArray[np.float64], polygons: list[Polygon], turn: NDArray[np.bool_]
) -> float:
    """Six times the volume that polygons enclose seen from their middle; negative if they face inward."""
    fans = np.array([(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)])
    sign = np.repeat(np.where(turn, -1.0, 1.0), [len(p) - 2 for p in polygons])
    a, b, c = (vertices[fans] - vertices[np.unique(fans)].mean(axis=0)).transpose(1, 0, 2)
    return float((sign * np.einsum("fd,fd->f", a, np.cross(b, c))).sum())


def _rims(polygons: list[Polygon], place: NDArray[np.int64]) -> list[Polygon]:
    """Simple loops of boundary edges, as vertices in the direction of their polygons."""
    at = [[int(place[vertex]) for vertex in polygon] for polygon in polygons]
    vertex_at = {place_: vertex for p, q in zip(at, polygons) for place_, vertex in zip(p, q)}
    return [[vertex_at[place_] for place_ in loop] for loop in boundary_loops(at)]
