"""Meshings of one face surface: crops, diagonal splits, decimations, remeshings, subdivisions, damage.

Each meshing is a set of faces and a sparse matrix W whose rows are barycentric weights on the source surface, so
neutral, expressions and identities are all carried by the same W and the linear model stays exact. Closest points are
searched only on triangles that touch the source vertices which collapsed (or clustered) into the new vertex: a
point of the upper lip can thus never land on the lower one, nor an upper lid on a lower lid.

Masks (carried by W, threshold one half):
    lip: frontal projection inside the outer-lip contour (landmarks 48-59) enlarged by 20 % about its centre.
    upper face: above the line 5 mm under the lower lids (mean of landmarks 40, 41, 46, 47), in front of the ears.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from freetalk.corpus.assets import EXTENTS, FaceModel, crop_quads, triangulate
from freetalk.data.triangles import closest_on_triangles

Faces = npt.NDArray[np.int32]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Meshing:
    """A meshing: faces (F, 3) and carry matrix (V, source vertices); `noise_m` perturbs its neutral."""

    faces: Faces
    carry: sp.csr_matrix
    noise_m: float = 0.0


@dataclass(frozen=True)
class TopologySpec:
    """Name, split and recipe of one topology of the corpus."""

    name: str
    split: str
    description: str
    build: Callable[[FaceModel], Meshing]


def crop(model: FaceModel, extent: str, other_diagonal: bool = False) -> Meshing:
    """The leading vertices of an extent with its own triangles."""
    faces = triangulate(crop_quads(model, extent), other_diagonal)
    count = EXTENTS[extent]
    return Meshing(faces, sp.eye(count, len(model.neutral), format="csr"))


def short_diagonals(model: FaceModel, extent: str) -> Meshing:
    """Each quad split along its shorter diagonal."""
    quads = crop_quads(model, extent)
    corners = model.neutral[quads]
    first = np.linalg.norm(corners[:, 0] - corners[:, 2], axis=-1)
    second = np.linalg.norm(corners[:, 1] - corners[:, 3], axis=-1)
    flip = (quads[:, 3] >= 0) & (second < first)
    faces = np.concatenate([triangulate(quads[~flip]), triangulate(quads[flip], True)])
    return Meshing(faces, sp.eye(EXTENTS[extent], len(model.neutral), format="csr"))


def drop_unused(faces: Faces, carry: sp.csr_matrix) -> Meshing:
    """Drops faces with repeated corners and vertices that no face uses."""
    distinct = (
        (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    )
    used, inverse = np.unique(faces[distinct], return_inverse=True)
    return Meshing(inverse.reshape(-1, 3).astype(np.int32), carry[used].tocsr())


def decimate(model: FaceModel, base: Meshing, vertices: int) -> Meshing:
    """Quadric decimation (fast_simplification) towards a number of vertices."""
    import fast_simplification

    source = np.ascontiguousarray(base.carry @ model.neutral, np.float64)
    target = max(4, int(round(len(base.faces) * vertices / len(source))))
    _, _, collapses = fast_simplification.simplify(
        source, base.faces, target_count=target, agg=3.0, return_collapses=True
    )
    points, faces, group = fast_simplification.replay_simplification(source, base.faces, collapses)
    carry = carry_from_groups(points.astype(np.float64), source, base.faces, group.astype(np.int64))
    return drop_unused(faces.astype(np.int32), (carry @ base.carry).tocsr())


def remesh(model: FaceModel, base: Meshing, vertices: int) -> Meshing:
    """Isotropic remeshing by clustering (ACVD), on the base subdivided once so that clusters are fine."""
    import pyacvd
    import pyvista as pv

    fine = subdivide(base)
    source = np.ascontiguousarray(fine.carry @ model.neutral, np.float64)
    cells = np.c_[np.full(len(fine.faces), 3), fine.faces].ravel()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pyacvd calls a renamed pyvista attribute
        clusters = pyacvd.Clustering(pv.PolyData(source, cells))
        clusters.cluster(vertices)
    group = np.asarray(clusters.clusters, np.int64)
    faces = faces_of_clusters(group, fine.faces)
    count = int(group.max()) + 1
    size = np.bincount(group, minlength=count)
    means = [np.bincount(group, source[:, k], count) / np.maximum(size, 1) for k in range(3)]
    occupied = np.flatnonzero(size)
    renumber = np.full(count, -1)
    renumber[occupied] = np.arange(len(occupied))
    points = np.stack(means, 1)[occupied]
    carry = carry_from_groups(points, source, fine.faces, renumber[group])
    return drop_unused(renumber[faces].astype(np.int32), (carry @ fine.carry).tocsr())


def faces_of_clusters(group: npt.NDArray[np.int64], faces: Faces) -> Faces:
    """One triangle for every set of three clusters that meet in a source triangle."""
    corner = group[faces].astype(np.int32)
    distinct = (
        (corner[:, 0] != corner[:, 1])
        & (corner[:, 1] != corner[:, 2])
        & (corner[:, 2] != corner[:, 0])
    )
    corner = corner[distinct]
    _, first = np.unique(np.sort(corner, axis=1), axis=0, return_index=True)
    return corner[np.sort(first)]


def subdivide(base: Meshing) -> Meshing:
    """Each triangle into four at the edge midpoints."""
    count = base.carry.shape[0]
    edges = np.sort(base.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, inverse = np.unique(edges, axis=0, return_inverse=True)
    middle = (count + inverse.reshape(-1, 3)).astype(np.int32)
    a, b, c = base.faces.T
    ab, bc, ca = middle.T
    faces = np.concatenate(
        [np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    )
    half = np.full(2 * len(unique), 0.5)
    rows = np.repeat(np.arange(len(unique)), 2)
    midpoints = sp.csr_matrix((half, (rows, unique.ravel())), shape=(len(unique), count))
    return Meshing(faces, sp.vstack([base.carry, midpoints @ base.carry]).tocsr())


def damage(
    model: FaceModel,
    base: Meshing,
    holes: int,
    radius_m: float,
    noise_m: float,
    torn: int,
    seed: int,
) -> Meshing:
    """Cuts round holes, tears edges open along random cuts and adds noise to the neutral.

    Tearing duplicates the vertices of random faces, so the mesh gets cracks, extra boundary and loose triangles.
    """
    rng = np.random.default_rng(seed)
    points = base.carry @ model.neutral
    keep = np.ones(len(points), bool)
    for centre in rng.choice(len(points), holes, replace=False):
        keep &= np.linalg.norm(points - points[centre], axis=1) > radius_m * rng.uniform(0.5, 1.0)
    faces = base.faces[keep[base.faces].all(axis=1)].copy()
    carry = base.carry
    if torn:
        chosen = rng.choice(len(faces), torn, replace=False)
        extra = faces[chosen].ravel()
        carry = sp.vstack([carry, carry[extra]]).tocsr()
        faces[chosen] = len(points) + np.arange(len(extra), dtype=np.int32).reshape(-1, 3)
    result = drop_unused(faces, carry)
    return Meshing(result.faces, result.carry, noise_m)


def region_masks(model: FaceModel) -> tuple[FloatArray, FloatArray]:
    """Lip and upper-face indicators (0 or 1) on the source vertices; the rules are in the module's docstring."""
    points = model.neutral.astype(np.float64)
    landmarks = points[model.landmarks68]
    contour = landmarks[48:60, :2]
    contour = contour.mean(0) + 1.2 * (contour - contour.mean(0))
    inside = np.zeros(len(points), bool)
    for (x0, y0), (x1, y1) in zip(contour, np.roll(contour, -1, axis=0), strict=True):
        crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
        at = x0 + (points[:, 1] - y0) / (y1 - y0 if y1 != y0 else 1e-12) * (x1 - x0)
        inside ^= crosses & (points[:, 0] < at)
    front = points[:, 2] > landmarks[0, 2]
    surface = np.arange(len(points)) < EXTENTS["face"]
    lip = inside & (points[:, 2] > landmarks[[48, 54], 2].min() - 0.01) & surface
    lower_lids = landmarks[[40, 41, 46, 47], 1].mean()
    upper = surface & front & (points[:, 1] > lower_lids - 0.005)
    return lip.astype(np.float64), upper.astype(np.float64)


def _decimated(
    name: str, split: str, what: str, extent: str, count: int, other: bool = False
) -> TopologySpec:
    text = f"{what}, decimated to about {count:,} vertices"
    return TopologySpec(name, split, text, lambda m: decimate(m, crop(m, extent, other), count))


def _remeshed(name: str, split: str, extent: str, count: int, other: bool = False) -> TopologySpec:
    text = f"{_WHAT[extent]}, isotropic remeshing, about {count:,} vertices"
    return TopologySpec(name, split, text, lambda m: remesh(m, crop(m, extent, other), count))


def _damaged(
    name: str, split: str, text: str, extent: str, count: int, *how: Any, other: bool = False
) -> TopologySpec:
    text = f"{_WHAT[extent]}, about {count:,} vertices{text}"
    return TopologySpec(
        name, split, text, lambda m: damage(m, decimate(m, crop(m, extent, other), count), *how)
    )


_NECK, _SOCKETS = "face, head and neck", "head with sockets"
_WHAT = {"face": "face", "narrow": "narrow face", "head": _NECK, "sockets": _SOCKETS}
_OTHER = "split along the other diagonal"
_TORN = ", holes, tears and 0.{} mm noise"
TOPOLOGIES: tuple[TopologySpec, ...] = (
    _decimated("face_dec2500", "train", "face", "face", 2500),
    _decimated("narrow_dec1500", "train", "narrow face", "narrow", 1500),
    _decimated("head_dec2000", "train", _NECK, "head", 2000),
    _decimated("sockets_dec3000", "train", "head with mouth and eye sockets", "sockets", 3000),
    _decimated("face_dec1200", "train", f"face {_OTHER}", "face", 1200, True),
    _remeshed("narrow_iso2000", "train", "narrow", 2000),
    _remeshed("head_iso3000", "train", "head", 3000),
    TopologySpec(
        "face_sub3500",
        "train",
        "face decimated to about 900 vertices, each triangle split in four",
        lambda m: subdivide(decimate(m, crop(m, "face"), 900)),
    ),
    _damaged("narrow_torn2500", "train", _TORN.format(2), "narrow", 2500, 6, 0.012, 2e-4, 40, 11),
    _decimated("narrow_dec900", "train", "narrow face", "narrow", 900),
    _decimated("face_dec900", "train", "face", "face", 900),
    _decimated("head_dec1000", "train", f"{_NECK} {_OTHER}", "head", 1000, True),
    _decimated("sockets_dec1500", "train", _SOCKETS, "sockets", 1500),
    _remeshed("face_iso1000", "train", "face", 1000, True),
    _damaged("narrow_torn1000", "train", _TORN.format(2), "narrow", 1000, 5, 0.012, 2e-4, 20, 13),
    _damaged("head_torn1800", "train", _TORN.format(3), "head", 1800, 8, 0.012, 3e-4, 30, 17),
    _damaged(
        *("sockets_torn1700", "train", ", many small holes and tears", "sockets", 1700),
        *(14, 0.006, 0.0, 40, 19),
        other=True,
    ),
    TopologySpec(
        *("narrow", "train", "narrow face, original vertices, quads split 0-2"),
        lambda m: crop(m, "narrow"),
    ),
    _decimated("sockets_dec5000", "val", _SOCKETS, "sockets", 5000, True),
    _remeshed("face_iso2500", "val", "face", 2500),
    TopologySpec(
        *("face", "test", "face, original 9,409 vertices, quads split 1-3"),
        lambda m: crop(m, "face", True),
    ),
    _remeshed("face_iso5000", "test", "face", 5000, True),
    _damaged(
        *("head_holes4000", "test", " with holes and 0.3 mm noise", "head", 4000),
        *(10, 0.012, 3e-4, 60, 23),
        other=True,
    ),
    TopologySpec(
        *("sockets", "test"),
        "head with sockets, original 14,062 vertices, quads split along the shorter diagonal",
        lambda m: short_diagonals(m, "sockets"),
    ),
)

TINY_TOPOLOGIES = ("narrow_dec1500", "face_dec1200", "face_iso2500", "head_holes4000")


def topology_arrays(model: FaceModel, spec: TopologySpec, seed: int) -> dict[str, npt.NDArray]:
    """All arrays of a topology's file: neutral, faces, bases (float16, m) and masks."""
    meshing = spec.build(model)
    carry, count = meshing.carry, meshing.carry.shape[0]
    neutral = carry @ model.neutral.astype(np.float64)
    if meshing.noise_m > 0:
        rng = np.random.default_rng([seed, len(spec.name), count])
        neutral = neutral + rng.normal(0.0, meshing.noise_m, neutral.shape)

    def carried(basis: npt.NDArray[np.float32]) -> npt.NDArray[np.float16]:
        columns = carry[:, : basis.shape[1]]
        flat = columns @ basis.transpose(1, 0, 2).reshape(basis.shape[1], -1)
        return flat.reshape(count, len(basis), 3).transpose(1, 0, 2).astype(np.float16)

    lip, upper = region_masks(model)
    return {
        "neutral": neutral.astype(np.float32),
        "faces": meshing.faces.astype(np.int32),
        "expression_basis": carried(model.expression_basis),
        "identity_basis": carried(model.identity_basis),
        "lip_mask": carry @ lip > 0.5,
        "upper_face_mask": carry @ upper > 0.5,
    }


def carry_from_groups(
    points: FloatArray, source: FloatArray, faces: Faces, group: npt.NDArray[np.int64]
) -> sp.csr_matrix:
    """Barycentric carry of new points whose origin among the source vertices is known.

    Args:
        points: (P, 3) new positions.
        source: (V, 3) source vertices; faces: (F, 3) source triangles.
        group: (V,) index of the new point that each source vertex became, -1 for none.

    Returns:
        (P, V) sparse matrix, three weights a row.
    """
    corner_group = group[faces]
    triangle = np.repeat(np.arange(len(faces)), 3)
    pairs = np.unique(np.stack([corner_group.ravel(), triangle], 1), axis=0)
    pairs = pairs[pairs[:, 0] >= 0]
    target, triangle = pairs[:, 0], pairs[:, 1]
    weights, d2 = closest_on_triangles(points[target], source[faces[triangle]])
    order = np.lexsort((d2, target))
    first = np.unique(target[order], return_index=True)
    chosen = order[first[1]]
    if len(first[0]) != len(points):
        raise ValueError("a new vertex has no source vertex")
    rows = np.repeat(np.arange(len(points)), 3)
    columns = faces[triangle[chosen]].ravel()
    shape = (len(points), len(source))
    return sp.csr_matrix((weights[chosen].ravel(), (rows, columns)), shape=shape)
