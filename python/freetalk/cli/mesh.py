"""``freetalk mesh``."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from freetalk.cli.outputs import check_readable
from freetalk.cli.weights import find_weights


def check(arguments: argparse.Namespace) -> None:
    """Reports counts, extent, unit and pose of a mesh file."""
    file = check_readable(arguments.file, "a mesh (OBJ, PLY, OFF or STL)")
    import freetalk.geometry
    from freetalk import _native
    from freetalk.viz import boundary_rims, part_labels

    mesh: Any = freetalk.load_mesh(file)
    vertices = np.asarray(mesh.vertices)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    extent = np.ptp(vertices[used], axis=0)
    print(f"{file}: {len(vertices)} vertices, {len(faces)} triangles")
    print(f"  parts: {part_labels(faces, len(vertices))[used].max() + 1}")
    print(f"  open rims: {len(boundary_rims(faces, len(vertices)))}")
    print(f"  triangles without area: {int((area <= 1e-12 * area.max()).sum())}")
    print(f"  vertices in no triangle: {int((~used).sum())}")
    print(f"  extent: {extent[0]:.4g} x {extent[1]:.4g} x {extent[2]:.4g}")
    template = find_weights(arguments.pretrained) / "template.safetensors"
    tensors = _native.core.load_safetensors(
        check_readable(str(template), "weights with a template")
    )
    alignment: Any = freetalk.geometry.align_to_template(
        vertices,
        faces,
        tensors["points"],
        tensors["normals"],
        unit=arguments.unit,
        up=arguments.up,
        forward=arguments.forward,
    )
    print(f"  pose: {alignment.summary}")
