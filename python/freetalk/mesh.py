"""Mesh files, what a mesh is like, and normals: the mesh room as Python sees it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from freetalk._arrays import as_array
from freetalk._native import mesh as _native

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

Mesh = _native.Mesh
MeshReport = _native.MeshReport
Appearance = _native.Appearance
SlitOptions = _native.SlitOptions
LipSlit = _native.LipSlit
Reshaped = _native.Reshaped
Budgeted = _native.Budgeted

__all__ = [
    "Appearance",
    "Budgeted",
    "LipSlit",
    "Mesh",
    "MeshReport",
    "Reshaped",
    "SlitOptions",
    "boundary_loops",
    "close_holes",
    "connected_components",
    "cut_lips",
    "face_areas",
    "lips_are_joined",
    "load_appearance",
    "load_mesh",
    "mesh_report",
    "save_mesh",
    "to_vertex_budget",
    "vertex_normals",
]

boundary_loops = _native.boundary_loops
mesh_report = _native.mesh_report
load_appearance = _native.load_appearance


def load_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Reads an OBJ, PLY, OFF, STL, .gltf or .glb file.

    No face is dropped; ``mesh_report`` tells what is odd about a mesh. Of glTF, the triangles of all
    meshes its scene shows, moved by their nodes, at rest.

    Args:
        path: the file.

    Returns:
        The mesh with the file's vertices in the file's order, its polygons, texture coordinates and
        a triangulation.

    Raises:
        RuntimeError: missing, empty, not a mesh, no faces, indices out of range or NaN vertices; one
            sentence naming the file and what to do.
    """
    if Path(path).suffix.lower() == ".fbx":
        raise RuntimeError(
            f"{os.fspath(path)} is FBX, which is not read: export it as glTF (.glb) from Blender, Maya or 3ds Max, "
            "or convert it with 'assimp export head.fbx head.glb'"
        )
    return _native.load_mesh(Path(path))


def save_mesh(
    path: str | os.PathLike[str], mesh: Mesh, appearance: Appearance | None = None
) -> None:
    """Writes an OBJ or PLY file (by extension) atomically, polygons and texture coordinates kept.

    Args:
        path: the file.
        mesh: what to write.
        appearance: its materials, textures (written beside the file) and colours, as :func:`load_appearance` gives
            them.
    """
    if appearance is None:
        _native.save_mesh(Path(path), mesh)
    else:
        _native.save_mesh(Path(path), mesh, appearance)


def lips_are_joined(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    landmarks: ArrayLike | torch.Tensor,
) -> bool:
    """Whether upper and lower lip are one closed skin, as those of a scan.

    Args:
        vertices: (V, 3) m, canonical frame.
        faces: (F, 3).
        landmarks: (68, 3) m.
    """
    surface = as_array(vertices, np.float64), as_array(faces, np.int32)
    return _native.lips_are_joined(*surface, as_array(landmarks, np.float64))


def cut_lips(
    mesh: Mesh, landmarks: ArrayLike | torch.Tensor, *, options: SlitOptions | None = None
) -> LipSlit:
    """Cuts a slit along the crease between the lips and sews a pocket behind it.

    Edges around the slit are halved until they are short, which changes no surface.

    Args:
        mesh: outward polygons, canonical frame, m.
        landmarks: (68, 3) m.
        options: see ``SlitOptions``.

    Raises:
        ValueError: options or landmarks of another form.
        RuntimeError: the surface at the lips cannot be cut.
    """
    return _native.cut_lips(mesh, as_array(landmarks, np.float64), options=options or SlitOptions())


def to_vertex_budget(
    mesh: Mesh, vertices: int, importance: ArrayLike | torch.Tensor = ()
) -> Budgeted:
    """Thins a mesh out by quadric error, or halves its longest edges, which changes no surface.

    What is changed comes out in triangles; texture coordinates follow. Rims, seams of textures and polygons where the
    surface branches are not thinned out, so that more vertices may be left than wanted.

    Args:
        mesh: any polygons.
        vertices: how many are wanted.
        importance: (V,) > 0: edges that are worth as many times as much are as many times shorter; empty for the same
            everywhere.

    Raises:
        ValueError: arguments of another form.
    """
    return _native.to_vertex_budget(mesh, vertices, as_array(importance, np.float64))


def vertex_normals(vertices: ArrayLike | torch.Tensor, faces: ArrayLike | torch.Tensor) -> NDArray:
    """(V, 3) unit vertex normals: the mean of the unit normals of the faces around."""
    return _native.vertex_normals(as_array(vertices, np.float64), as_array(faces, np.int32))


def face_areas(vertices: ArrayLike | torch.Tensor, faces: ArrayLike | torch.Tensor) -> NDArray:
    """(F,) areas of triangles."""
    return _native.face_areas(as_array(vertices, np.float64), as_array(faces, np.int32))


def connected_components(num_vertices: int, faces: ArrayLike | torch.Tensor) -> NDArray:
    """(V,) component of each vertex; an unreferenced vertex is one of its own."""
    return _native.connected_components(num_vertices, as_array(faces, np.int32))


def close_holes(
    vertices: ArrayLike | torch.Tensor,
    faces: ArrayLike | torch.Tensor,
    *,
    max_edges: int = np.iinfo(np.int64).max,
) -> tuple[NDArray, NDArray, int]:
    """Closes holes by fans around their middles, which suits rims that are about star-shaped.

    Args:
        vertices: (V, 3).
        faces: (F, 3) triangles.
        max_edges: holes of more edges stay open.

    Returns:
        vertices (V + H, 3) with the middle of each closed hole last, faces (F', 3) with the lids last, and the number
        of edges that still have one triangle only.
    """
    return _native.close_holes(
        as_array(vertices, np.float64), as_array(faces, np.int32), max_edges=max_edges
    )
