"""Mouths that are there but closed: the inside of lips whose surface goes on behind them is taken out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from freetalk.corpus.linear_face import built_in_face
from freetalk.geometry import Similarity
from freetalk.mesh import Mesh, lips_are_joined, vertex_normals
from freetalk.prepare.repair import Prepared, places_of, polygons_of
from freetalk.stm import LandmarkFollower
from freetalk.viz.cavities import find_cavities

#: Of the inner lips, from corner to corner: above and below.
_UPPER, _LOWER = (60, 61, 62, 63, 64), (64, 65, 66, 67, 60)
_NOSE = 33
#: The lips stay so far (m) behind the line where they meet.
_LIPS_M = 0.005
#: The inside of a mouth is no farther (m) from its middle, or this is another surface.
_FARTHEST_M = 0.08


def open_mouth(prepared: Prepared, pose: Similarity, landmarks: NDArray[np.float64]) -> Prepared:
    """Takes out what closes a mouth behind its lips: a bag, or a web from one lip to the other.

    The inner lips' landmarks, joined over the surface, are the rim; what they cut off from the nose is the inside.

    Args:
        prepared: polygons that face outward.
        pose: from the mesh to the canonical frame, m.
        landmarks: (68, 3) in the mesh's own unit and axes.

    Returns:
        The mesh with an opening 5 mm behind the line of the lips; as it was where there is one, the lips are one skin,
        or the rim cuts off nothing.
    """
    mesh = prepared.mesh
    home = pose.apply(np.asarray(mesh.vertices, np.float64))
    faces, marks = np.asarray(mesh.faces), pose.apply(landmarks)
    if lips_are_joined(home, faces, marks):
        return prepared
    if find_cavities(home.astype(np.float32), faces.astype(np.int64)).mouth is not None:
        return prepared
    place = places_of(np.asarray(mesh.vertices))
    first = np.unique(place, return_index=True)[1]
    points = home[first]
    ways = _edges(place[faces], points)
    at = place[_vertices_of(home, faces, marks)]
    upper, lower = (_path(ways, [at[n] for n in ring]) for ring in (_UPPER, _LOWER))
    inside = _cut_off(ways, upper | lower, int(at[_NOSE]))
    middle = points[at[48:68]].mean(axis=0)
    if not inside.any() or np.linalg.norm(points[inside] - middle, axis=1).max() > _FARTHEST_M:
        return prepared
    rim = np.zeros(len(points), dtype=bool)
    rim[list(upper | lower)] = True
    within = inside | rim
    near = coo_matrix(ways)
    kept = within[near.row] & within[near.col]
    own = csr_matrix((near.data[kept], (near.row[kept], near.col[kept])), shape=near.shape)
    away = [dijkstra(own, indices=sorted(lip), min_only=True) for lip in (upper, lower)]
    deep = inside & (np.minimum(*away) > _LIPS_M)
    above, below = away[0] < away[1], away[1] < away[0]
    stays = []
    for number, polygon in enumerate(polygons_of(mesh)):
        corners = place[polygon]
        is_web = within[corners].all() and above[corners].any() and below[corners].any()
        if not (deep[corners].any() or is_web):
            stays.append(number)
    return _with_polygons(prepared, stays)


def _edges(faces: NDArray[np.int64], points: NDArray[np.float64]) -> csr_matrix:
    """(P, P) lengths of the edges, m."""
    a, b = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).T
    pairs = np.unique(np.sort(np.stack([a[a != b], b[a != b]], axis=1), axis=1), axis=0)
    length = np.maximum(np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1), 1e-9)
    one_way = csr_matrix((length, pairs.T), shape=(len(points), len(points)))
    return one_way + one_way.T


def _vertices_of(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], marks: NDArray[np.float64]
) -> NDArray[np.int64]:
    """(68,) the vertices nearest to the landmarks, each on its own lip."""
    face = built_in_face()
    neutral = np.asarray(face.neutral, np.float64)
    normals = vertex_normals(neutral, face.faces)[face.landmarks]
    follower = LandmarkFollower(vertices, faces, landmarks=marks, normals=normals)
    nearest: NDArray[np.int64] = follower.corners.gather(
        1, follower.shares.argmax(dim=1, keepdim=True)
    )[:, 0].numpy()
    return nearest


def _path(ways: csr_matrix, stations: list[int]) -> set[int]:
    """All places on the shortest ways from one station to the next; empty where there is none."""
    found = set(stations)
    for start, end in zip(stations, stations[1:]):
        before = dijkstra(ways, indices=start, return_predecessors=True)[1]
        while end != start:
            end = before[end]
            if end < 0:
                return set()
            found.add(int(end))
    return found


def _cut_off(ways: csr_matrix, rim: set[int], outside: int) -> NDArray[np.bool_]:
    """Places that a rim separates from one outside, and that border on it."""
    edges = coo_matrix(ways)
    on_rim = np.zeros(ways.shape[0], dtype=bool)
    on_rim[list(rim)] = True
    free = ~(on_rim[edges.row] | on_rim[edges.col])
    graph = csr_matrix((edges.data[free], (edges.row[free], edges.col[free])), shape=ways.shape)
    part = connected_components(graph, directed=False)[1]
    beside = np.unique(part[edges.col[on_rim[edges.row] & ~on_rim[edges.col]]])
    return ~on_rim & np.isin(part, beside) & (part != part[outside])


def _with_polygons(prepared: Prepared, stays: list[int]) -> Prepared:
    """The mesh with some of its polygons only, and the vertices that they have."""
    mesh = prepared.mesh
    own = polygons_of(mesh)
    polygons = [own[k] for k in stays]
    used = np.zeros(len(mesh.vertices), dtype=bool)
    used[np.concatenate([np.asarray(polygon) for polygon in polygons])] = True
    now = np.where(used, np.cumsum(used) - 1, -1)
    colours = np.asarray(prepared.appearance.colours)
    texture = mesh.polygon_texcoords
    corners = [list(texture[k]) for k in stays] if len(mesh.texcoords) else []
    opened = Mesh(
        np.asarray(mesh.vertices)[used],
        [now[polygon].tolist() for polygon in polygons],
        texcoords=mesh.texcoords,
        polygon_texcoords=corners,
        name=mesh.name,
    )
    old = prepared.vertex_map
    return Prepared(
        opened,
        np.where(old >= 0, now[old], -1),
        [*prepared.steps, f"the mouth opened behind the lips ({len(own) - len(stays)} polygons)"],
        prepared.appearance.carried(stays, colours[used] if len(colours) else colours),
    )
