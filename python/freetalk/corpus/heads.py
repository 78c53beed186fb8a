"""Watertight heads of the built-in face model: what a neural parametric head is trained on and judged by.

The mesh is one disk whose only border is the neck. The neck is capped, the inside of the mouth is cut 25 mm behind the
lips and capped, and a ball, carried by the rim of the lids, fills each eye socket. Balls and lips overlap, so inside is
where the winding number is at least 1/2. The canonical face has its mouth open: 0.25 jawOpen, lips 1 cm apart.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from freetalk.corpus.assets import EXTENTS, FaceModel, crop_quads, load_face_model, triangulate
from freetalk.geometry import SurfaceTree, isosurface
from freetalk.mesh import Mesh, boundary_loops, save_mesh, vertex_normals

Array = npt.NDArray[np.float32]
Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

CANONICAL_JAW = 0.25
"""Weight of jawOpen in the canonical face."""
NUM_COEFFICIENTS = 100
LARGEST_COEFFICIENT = 2.5
NUM_HELD_OUT = 32
"""Identities that no training draws."""
NUM_PAIRS, NUM_ANCHORS = 16, 39
"""Mirrored pairs of anchors, which come first, and all anchors."""

_MOUTH_DEPTH_M = 0.025
# ICT-FaceKit's eyeball without its cornea; the other one is mirrored.
_EYE_CENTER_M, _EYE_RADIUS_M = np.array([0.0312, 0.0386, -0.0145]), 0.0158
_LIDS = (slice(42, 48), slice(36, 42))  # landmarks; of the eye at +X, and at -X
_PAIRED_LANDMARKS = (26, 22, 45, 42, 44, 46, 35, 54, 52, 56, 12, 14)
_MIDDLE_LANDMARKS = (27, 30, 51, 57, 8)
_HELD_OUT_SEED = 20_240
_VISIBLE_M = 1e-4  # a point of the surface is outside this far along its normal


@dataclass(frozen=True)
class HeadModel:
    """The linear face as a closed surface of a skin and two balls.

    Attributes:
        neutral: (V, 3) m, canonical frame: the skin, with the middles of its two caps last.
        identity_basis: (100, V, 3) m.
        expression_basis: (E, V, 3) m.
        skin: (F, 3) its triangles.
        ball: (B, 3) and (G, 3): a unit sphere.
        lids: for each eye, vertices of the rim that carries it.
        anchors: (39,) vertices: 16 pairs, the one at +X first, and 7 in the middle plane.
        is_face: (V,) the front of the face, whose accuracy counts most.
        is_lips: (V,) within 8 mm of the inner lips.
        expression_names: the E names.
    """

    neutral: Points
    identity_basis: Points
    expression_basis: Points
    skin: npt.NDArray[np.int32]
    ball: tuple[Points, npt.NDArray[np.int32]]
    lids: tuple[Indices, Indices]
    anchors: Indices
    is_face: npt.NDArray[np.bool_]
    is_lips: npt.NDArray[np.bool_]
    expression_names: tuple[str, ...]

    @property
    def faces(self) -> npt.NDArray[np.int32]:
        """Triangles of skin and balls."""
        first, count = len(self.neutral), len(self.ball[0])
        balls = [self.ball[1] + first, self.ball[1] + first + count]
        return np.concatenate([self.skin, *balls]).astype(np.int32)

    @property
    def canonical_weights(self) -> Array:
        """(E,) expression weights of the canonical face."""
        weights = np.zeros(len(self.expression_names), np.float32)
        weights[self.expression_names.index("jawOpen")] = CANONICAL_JAW
        return weights

    def vertices(self, coefficients: npt.ArrayLike, weights: npt.ArrayLike) -> Points:
        """Vertices (V + 2 B, 3), m, of an identity (100,) and expression weights (E,): skin, then balls."""
        shape = self.neutral + np.tensordot(np.asarray(coefficients, float), self.identity_basis, 1)
        balls = []
        for lids, side in zip(self.lids, (1.0, -1.0)):
            rim, mean_rim = shape[lids], self.neutral[lids]
            grown = np.sqrt(rim.var(axis=0).sum() / mean_rim.var(axis=0).sum())
            center = _EYE_CENTER_M * [side, 1, 1] - mean_rim.mean(axis=0)
            balls.append(rim.mean(axis=0) + grown * (center + _EYE_RADIUS_M * self.ball[0]))
        shape = shape + np.tensordot(np.asarray(weights, float), self.expression_basis, 1)
        return np.concatenate([shape, *balls])


@lru_cache(maxsize=1)
def head_model() -> HeadModel:
    """The built-in face made watertight; cached."""
    model = load_face_model()
    skin = _without_throat(model, triangulate(crop_quads(model, "sockets")))
    kept, index = np.unique(skin, return_inverse=True)
    skin = index.reshape(-1, 3).astype(np.int32)
    loops = boundary_loops(skin.tolist())
    if len(loops) != 2:
        raise RuntimeError(f"the built-in head must have a neck and a mouth to cap, found {loops}")
    fans = [
        np.column_stack([np.roll(loop, -1), loop, np.full(len(loop), len(kept) + number)])
        for number, loop in enumerate(loops)
    ]

    def capped(values: npt.NDArray[np.floating]) -> Points:
        own = values[..., kept, :].astype(np.float64)
        middles = [own[..., loop, :].mean(axis=-2, keepdims=True) for loop in loops]
        return np.concatenate([own, *middles], axis=-2)

    neutral = capped(model.neutral)
    place = np.full(len(model.neutral), -1)
    place[kept] = np.arange(len(kept))
    landmarks = place[model.landmarks68]
    lips = neutral[landmarks[60:68]]
    away = np.linalg.norm(neutral[:, None] - lips, axis=-1).min(axis=1)
    source = np.append(kept, [len(model.neutral)] * 2)
    return HeadModel(
        neutral=neutral,
        identity_basis=capped(model.identity_basis),
        expression_basis=capped(model.expression_basis),
        skin=np.concatenate([skin, *fans]).astype(np.int32),
        ball=_unit_ball(),
        lids=(landmarks[_LIDS[0]], landmarks[_LIDS[1]]),
        anchors=_anchors(neutral, landmarks, source < EXTENTS["head"]),
        is_face=source < EXTENTS["narrow"],
        is_lips=(away < 0.008) & (source < EXTENTS["narrow"]),
        expression_names=model.expression_names,
    )


def draw_identity(rng: np.random.Generator) -> Array:
    """(100,) coefficients from N(0, 1) up to 2.5 away from 0."""
    drawn = rng.normal(size=NUM_COEFFICIENTS).clip(-LARGEST_COEFFICIENT, LARGEST_COEFFICIENT)
    return drawn.astype(np.float32)


def held_out_identities() -> Array:
    """(32, 100) coefficients of the identities that heads are judged by; no training draws from their seed."""
    rng = np.random.default_rng(_HELD_OUT_SEED)
    return np.stack([draw_identity(rng) for _ in range(NUM_HELD_OUT)])


def write_heads(
    out: Path,
    *,
    count: int,
    held_out: bool = False,
    expression: Mapping[str, float] | None = None,
    seed: int = 0,
) -> list[Path]:
    """Writes watertight heads as ``head_000.ply``, ... in metres.

    Args:
        out: folder to write to.
        count: how many; of the held-out ones at most 32.
        held_out: the identities that no training draws, instead of random ones.
        expression: weights by name; None is the canonical face.
        seed: of random identities.

    Returns:
        The files.

    Raises:
        ValueError: an unknown expression.
    """
    model = head_model()
    weights = model.canonical_weights
    if expression:
        unknown = sorted(set(expression) - set(model.expression_names))
        if unknown:
            known = ", ".join(model.expression_names)
            raise ValueError(f"unknown expression {unknown[0]!r}; there are: {known}")
        weights = np.array([expression.get(n, 0.0) for n in model.expression_names], np.float32)
    rng = np.random.default_rng(seed)
    chosen = (
        held_out_identities()[:count] if held_out else [draw_identity(rng) for _ in range(count)]
    )
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, coefficients in enumerate(chosen):
        path = out / f"head_{number:03d}.ply"
        mesh = Mesh(model.vertices(coefficients, weights), model.faces.tolist(), name=path.stem)
        save_mesh(path, mesh)
        paths.append(path)
    return paths


class SurfacePoints(NamedTuple):
    """Points on a head's triangles.

    Attributes:
        faces: (N,) rows of the head's triangles.
        shares: (N, 3) barycentric coordinates.
    """

    faces: Indices
    shares: Points

    def of(self, values: Points, faces: npt.NDArray[np.int32]) -> Points:
        """(N, ...) values (V, ...) of the vertices at these points."""
        return np.einsum("nc,nc...->n...", self.shares, values[faces[self.faces]])

    def take(self, which: npt.NDArray[np.bool_] | Indices) -> SurfacePoints:
        """Some of them."""
        return SurfacePoints(self.faces[which], self.shares[which])


class PosedHead:
    """A head of one identity and expression, ready for samples of its signed distance; metres.

    Args:
        model: the closed surface.
        coefficients: (100,) of the identity.
        weights: (E,) of the expression.
    """

    def __init__(
        self, model: HeadModel, coefficients: npt.ArrayLike, weights: npt.ArrayLike
    ) -> None:
        self.model = model
        self.faces = model.faces
        self.vertices = model.vertices(coefficients, weights)
        self.normals = vertex_normals(self.vertices, self.faces)
        self._tree = SurfaceTree(self.vertices, self.faces)
        corners = self.vertices[self.faces]
        self._areas = 0.5 * np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )

    def signed_distance(self, points: Points) -> Points:
        """(N,) of points (N, 3)."""
        return self._tree.signed_distance(points)

    def draw(self, rng: np.random.Generator, count: int, face_share: float) -> SurfacePoints:
        """Points that are seen from outside, at most `count`: a share of them on the face, the rest anywhere."""
        on_face = np.zeros(len(self.faces), dtype=bool)
        skin = len(self.model.skin)
        on_face[:skin] = self.model.is_face[self.model.skin].all(axis=1)
        on_face[skin:] = True  # the balls
        chance = self._areas * (1 - face_share) / self._areas.sum()
        chance[on_face] += self._areas[on_face] * face_share / self._areas[on_face].sum()
        chosen = rng.choice(len(self.faces), count, p=chance / chance.sum())
        shares = rng.dirichlet((1.0, 1.0, 1.0), count)
        drawn = SurfacePoints(chosen, shares)
        return drawn.take(self.is_seen(drawn))

    def is_seen(self, drawn: SurfacePoints) -> npt.NDArray[np.bool_]:
        """(N,) whether points lie on the outer surface: not on a ball within the head, nor where lips overlap."""
        outside = self.place(drawn, np.full(len(drawn.faces), _VISIBLE_M))
        return self._tree.winding_number(outside) < 0.5

    def is_outer(self) -> npt.NDArray[np.bool_]:
        """(F,) the triangles whose middles lie on the outer surface."""
        count = len(self.faces)
        return self.is_seen(SurfacePoints(np.arange(count), np.full((count, 3), 1 / 3)))

    def place(self, drawn: SurfacePoints, offsets: Points) -> Points:
        """(N, 3) points moved along their normals by offsets (N,)."""
        return drawn.of(self.vertices, self.faces) + offsets[:, None] * self.normal(drawn)

    def normal(self, drawn: SurfacePoints) -> Points:
        """(N, 3) unit normals at points."""
        normals = drawn.of(self.normals, self.faces)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True).clip(1e-9)

    def is_nearest(self, drawn: SurfacePoints, offsets: Points) -> npt.NDArray[np.bool_]:
        """(N,) whether the offset points belong to their own point: it is (up to 10 %) the nearest of the surface.

        Beyond about half of a gap, between the lips or a lid and its ball, the other side is nearer.
        """
        found = self.signed_distance(self.place(drawn, offsets))
        return np.abs(found - offsets) <= 0.1 * np.abs(offsets) + 1e-6


def draw_pairs(
    canonical: PosedHead, posed: PosedHead, rng: np.random.Generator, count: int, spread_m: float
) -> tuple[Points, Points]:
    """Points of the canonical and the posed head that correspond, about a third less than `count`.

    They lie off both surfaces by the same distance along the normals, up to where either gap would make two points
    of one head share a place.

    Args:
        canonical: of an identity.
        posed: of the same identity.
        rng: what they are drawn from.
        count: how many are tried.
        spread_m: standard deviation of most of the offsets; a third has a fifth of it.

    Returns:
        canonical and posed points (N, 3), m.
    """
    drawn = posed.draw(rng, count, face_share=0.8)
    fine = rng.random(len(drawn.faces)) < 1 / 3
    offsets = rng.normal(size=len(drawn.faces)) * np.where(fine, 0.2, 1.0) * spread_m
    kept = (
        posed.is_nearest(drawn, offsets)
        & canonical.is_seen(drawn)
        & canonical.is_nearest(drawn, offsets)
    )
    drawn, offsets = drawn.take(kept), offsets[kept]
    return canonical.place(drawn, offsets), posed.place(drawn, offsets)


def _without_throat(model: FaceModel, faces: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Triangles but those of the mouth's inside that reach further back than 25 mm behind the lips."""
    lips = model.neutral[model.landmarks68[60:68]]
    place = model.neutral[: EXTENTS["sockets"]]
    inside = np.arange(len(place)) >= EXTENTS["head"]  # of mouth and eye sockets, which lie above 0
    deep = inside & (place[:, 1] < 0) & (place[:, 2] < lips[:, 2].max() - _MOUTH_DEPTH_M)
    return faces[~deep[faces].any(axis=1)]


def _unit_ball() -> tuple[Points, npt.NDArray[np.int32]]:
    axis = np.linspace(-1.2, 1.2, 15)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    vertices, faces = isosurface(
        np.linalg.norm(places, axis=-1) - 1, origin=(-1.2,) * 3, spacing=(axis[1] - axis[0],) * 3
    )
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def _anchors(neutral: Points, landmarks: Indices, outer: npt.NDArray[np.bool_]) -> Indices:
    """Landmarks, and vertices of the outer skin as far as possible from them and each other; see HeadModel."""
    candidates = np.flatnonzero(outer)

    def mirrored(vertex: int) -> int:
        away = np.linalg.norm(neutral[candidates] - neutral[vertex] * [-1, 1, 1], axis=1)
        return int(candidates[away.argmin()])

    pairs = [int(landmarks[n]) for n in _PAIRED_LANDMARKS]
    middle = [int(landmarks[n]) for n in _MIDDLE_LANDMARKS]
    aside = candidates[neutral[candidates, 0] > 0.02]
    central = candidates[np.abs(neutral[candidates, 0]) < 0.002]
    while len(pairs) < NUM_PAIRS or len(middle) < NUM_ANCHORS - 2 * NUM_PAIRS:
        centered = len(middle) < NUM_ANCHORS - 2 * NUM_PAIRS
        among = central if centered else aside
        placed = neutral[[*pairs, *map(mirrored, pairs), *middle]]
        away = np.linalg.norm(neutral[among, None] - placed, axis=-1).min(axis=1)
        (middle if centered else pairs).append(int(among[away.argmax()]))
    both = [vertex for pair in pairs for vertex in (pair, mirrored(pair))]
    return np.array([*both, *middle])
