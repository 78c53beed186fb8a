"""Surface operators, eigenbases and alignment: the geometry room as Python sees it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from freetalk._arrays import as_array
from freetalk._native import geometry as _native
from freetalk._native.core import default_cache_dir
from freetalk._progress import ShareProgress, progress_bar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Alignment = _native.Alignment
AlignOptions = _native.AlignOptions
Eigenbasis = _native.Eigenbasis
EigenbasisOptions = _native.EigenbasisOptions
FaceOperators = _native.FaceOperators
OperatorOptions = _native.OperatorOptions
Similarity = _native.Similarity
SparseOperator = _native.SparseOperator
SurfaceOperators = _native.SurfaceOperators
SurfaceTree = _native.SurfaceTree

__all__ = [
    "AlignOptions",
    "Alignment",
    "Eigenbasis",
    "EigenbasisOptions",
    "FaceOperators",
    "OperatorOptions",
    "Similarity",
    "SparseOperator",
    "SurfaceOperators",
    "SurfaceTree",
    "align_to_template",
    "concatenate",
    "cotan_laplacian",
    "default_cache_dir",
    "eigenbasis",
    "isosurface",
    "isosurface_of_cells",
    "lumped_mass",
    "point_cloud_laplacian",
    "robust_laplacian",
    "sample_template",
    "signed_distance",
    "surface_operators",
    "unique_edges",
]

concatenate = _native.concatenate
unique_edges = _native.unique_edges
cotan_laplacian = _native.cotan_laplacian


def lumped_mass(vertices: ArrayLike | torch.Tensor, faces: ArrayLike | torch.Tensor) -> NDArray:
    """(V,) a third of the area of the faces around each vertex."""
    return _native.lumped_mass(as_array(vertices, np.float64), as_array(faces, np.int32))


def robust_laplacian(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    *,
    mollify_factor: float = 1e-5,
) -> tuple[Any, NDArray]:
    """The tufted Laplacian of triangles (Sharp & Crane, "A Laplacian for Nonmanifold Triangle Meshes").

    For any triangles: non-manifold, torn, a soup, inconsistently oriented, without area. Equal to
    the package ``robust_laplacian``.

    Args:
        vertices: (V, 3) any unit.
        faces: (F, 3) integer triangles.
        mollify_factor: least slack of the triangle inequalities in mean edge lengths; 0 for none.

    Returns:
        The Laplacian, (V, V) scipy sparse, positive semi-definite, no positive entry off the
        diagonal; and the lumped mass (V,), length^2.

    Raises:
        ValueError: NaN, indices out of range, no faces, all edges of length zero.
    """
    return _native.robust_laplacian(
        as_array(vertices, np.float64), as_array(faces, np.int32), mollify_factor=mollify_factor
    )


def point_cloud_laplacian(
    points: ArrayLike | torch.Tensor,
    *,
    mollify_factor: float = 1e-5,
    num_neighbors: int = 30,
    published_fit: bool = True,
) -> tuple[Any, NDArray]:
    """The tufted Laplacian of a point cloud (Sharp & Crane, Section 5.7).

    Args:
        points: (V, 3) any unit.
        mollify_factor: least slack of the triangle inequalities in mean edge lengths; 0 for none.
        num_neighbors: neighbours a point is triangulated with, 3 .. V - 1.
        published_fit: fit neighbourhoods as the package ``robust_laplacian`` 1.1 does, for equal
            results. Its planes lean towards the origin and it misses some boundary points; False
            does neither, and the result follows a translation and a rotation of the points.
            ``surface_operators`` uses False.

    Returns:
        The Laplacian, (V, V) scipy sparse, and the lumped mass (V,), length^2.

    Raises:
        ValueError: NaN, ``num_neighbors`` out of range.
    """
    return _native.point_cloud_laplacian(
        as_array(points, np.float64),
        mollify_factor=mollify_factor,
        num_neighbors=num_neighbors,
        published_fit=published_fit,
    )


def eigenbasis(
    laplacian: Any,
    mass: ArrayLike | torch.Tensor,
    k: int = 128,
    *,
    tolerance: float = 1e-6,
    solver: str = "auto",
    name: str = "mesh",
    progress: bool | ShareProgress | None = True,
) -> Eigenbasis:
    """The k smallest eigenpairs of L φ = λ M φ, in float64, for a diagonal M.

    The same bits for any number of threads. 1e-8 is added to the diagonal of L.

    Args:
        laplacian: (V, V) scipy sparse, symmetric, positive semi-definite.
        mass: (V,) positive: the diagonal of M.
        k: number of eigenpairs, at most V.
        tolerance: largest residual |L φ - λ M φ| / (λ |M φ|) accepted; small λ count as 4π / area.
        solver: "auto" (by size), "block" (shift-invert block Lanczos), "spectra" (the reference:
            shift-invert Lanczos of the Spectra library) or "dense" (full decomposition).
        name: names the mesh in messages.
        progress: a bar on a terminal once it takes over two seconds, nothing, or a callback that is
            given the finished share; it may raise to stop.

    Returns:
        ``evals`` (K,) ascending, ``evecs`` (V, K) with evecsᵀ M evecs = I, and ``residuals`` (K,).

    Raises:
        ValueError: more eigenpairs than vertices, a mass that is not positive, shapes that differ.
        RuntimeError: a larger subspace and shift did not converge either; names the mesh.
    """
    options = EigenbasisOptions(k=int(k), tolerance=float(tolerance), solver=solver)
    with progress_bar(progress, f"eigenbasis of {name}") as report:
        return _native.eigenbasis(
            laplacian, as_array(mass, np.float64), options=options, name=name, progress=report
        )


def surface_operators(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    k: int = 128,
    cache: bool | str | os.PathLike[str] = True,
    *,
    laplacian: str = "cotan",
    regularization: str = "relative",
    name: str = "mesh",
    max_cache_bytes: int = 4 << 30,
    progress: bool | ShareProgress | None = True,
) -> SurfaceOperators:
    """Mass, eigenbasis, gradients and normals of a surface, in float64 on the CPU.

    Args:
        vertices: (V, 3) any unit.
        faces: (F, 3) integer triangles; (0, 3) for a point cloud, with ``laplacian="robust"``.
        k: number of eigenpairs, at most V.
        cache: keep the result on disk: True for the default folder ($FREETALK_CACHE or
            ~/.cache/freetalk), a path for another, False to compute.
        laplacian: "cotan" (as the public ``diffusion_net``) or "robust" (tufted, Sharp & Crane 2020:
            for torn and non-manifold meshes, triangle soups and point clouds).
        regularization: "relative" (operators follow a uniform scale exactly) or "absolute" (the
            constants of the public ``diffusion_net`` package).
        name: names the mesh in messages.
        max_cache_bytes: the folder is kept below this: entries unused for longest go.
        progress: a bar on a terminal once it takes over two seconds, nothing, or a callback that is
            given the finished share; it may raise to stop.

    Returns:
        The operators; ``.to(dtype, device)`` and ``.scaled(factor)`` give converted ones.

    Raises:
        ValueError: NaN, indices out of range, more eigenpairs than vertices, no area.
        RuntimeError: the eigensolver did not converge; names the mesh.
    """
    options = OperatorOptions(k_eig=int(k), laplacian=laplacian, regularization=regularization)
    points, triangles = as_array(vertices, np.float64), as_array(faces, np.int32)
    with progress_bar(progress, f"operators of {name}") as report:
        if cache is False:
            return _native.surface_operators(
                points, triangles, options=options, name=name, progress=report
            )
        return _native.cached_surface_operators(
            points,
            triangles,
            options=options,
            cache_dir=default_cache_dir() if cache is True else Path(cache),
            name=name,
            max_bytes=int(max_cache_bytes),
            progress=report,
        )


def sample_template(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    num_points: int = 3000,
    seed: int = 0,
) -> tuple[NDArray, NDArray]:
    """Samples a surface evenly, for use as an alignment template.

    Returns:
        points (P, 3) and unit normals (P, 3), in the frame of ``vertices``.
    """
    return _native.sample_surface(
        as_array(vertices, np.float64), as_array(faces, np.int32), num_points=num_points, seed=seed
    )


def align_to_template(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    template_points: ArrayLike | torch.Tensor,
    template_normals: ArrayLike | torch.Tensor,
    *,
    unit: str = "auto",
    up: str = "auto",
    forward: str = "auto",
) -> Alignment:
    """Brings a face or head mesh of any unit and pose to the frame of a face template.

    Args:
        vertices: (V, 3) a face mask, head or bust; its largest part is fitted.
        faces: (F, 3) triangles.
        template_points: (P, 3) metres, samples of the mean face in the canonical frame.
        template_normals: (P, 3) their unit normals.
        unit: "auto", "m", "cm", "mm" or "in".
        up: "auto" or the mesh axis towards the top of the head: "+x", "-x", "+y", ...
        forward: "auto" or the mesh axis out of the face.

    Returns:
        The similarity to the canonical frame, what was guessed, the residual and a summary.

    Raises:
        ValueError: an unknown unit or axis, a template of fewer than 100 points, no area.
    """
    return _native.align_to_template(
        as_array(vertices, np.float64),
        as_array(faces, np.int32),
        template_points=as_array(template_points, np.float64),
        template_normals=as_array(template_normals, np.float64),
        options=AlignOptions(unit=unit, up=up, forward=forward),
    )


def isosurface(
    values: ArrayLike | torch.Tensor,
    *,
    level: float = 0.0,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    spacing: ArrayLike = (1.0, 1.0, 1.0),
) -> tuple[NDArray, NDArray]:
    """The surface of a level of a field on a regular grid, by marching cubes.

    The mesh is manifold; its only borders lie on the grid's. Faces turn towards larger values: outward for a signed
    distance that is negative inside. The result has the same bits for any number of threads.

    Args:
        values: (X, Y, Z) of the field, float32; NaN counts as above the level.
        level: the value of the surface.
        origin: (3,) place of ``values[0, 0, 0]``.
        spacing: (3,) between neighbours of each axis.

    Returns:
        vertices (V, 3) float64 and faces (F, 3) int32.

    Raises:
        ValueError: another shape, fewer than two values along an axis, spacing that is not positive.
    """
    return _native.isosurface(
        as_array(values, np.float32),
        level=level,
        origin=as_array(origin, np.float64),
        spacing=as_array(spacing, np.float64),
    )


def isosurface_of_cells(
    corners: ArrayLike | torch.Tensor,
    values: ArrayLike | torch.Tensor,
    cells: ArrayLike | torch.Tensor,
    *,
    level: float = 0.0,
) -> tuple[NDArray, NDArray]:
    """The surface of a level of a field within chosen cells of one grid, as an octree leaves them.

    Args:
        corners: (P, 3) places, each once.
        values: (P,) of the field there, float32.
        cells: (N, 8) rows of ``corners``, corner 4 x + 2 y + z at the lower (0) or upper (1) side of each axis.
        level: the value of the surface.

    Returns:
        vertices (V, 3) float64 and faces (F, 3) int32; cells that cross the level and are left out leave a border.

    Raises:
        ValueError: other shapes, rows out of range.
    """
    return _native.isosurface_of_cells(
        as_array(corners, np.float64),
        as_array(values, np.float32),
        cells=as_array(cells, np.int32),
        level=level,
    )


def signed_distance(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    points: ArrayLike | torch.Tensor,
) -> NDArray:
    """(N,) distances of points to a mesh, negative where its winding number is at least 1/2.

    Args:
        vertices: (V, 3).
        faces: (F, 3) triangles, outward.
        points: (N, 3). For points in several calls, keep a ``SurfaceTree``.

    Raises:
        ValueError: no faces, indices out of range, values that are not finite.
    """
    tree = SurfaceTree(as_array(vertices, np.float64), as_array(faces, np.int32))
    return tree.signed_distance(as_array(points, np.float64))
