"""``freetalk mesh``."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from freetalk.cli.outputs import check_readable
from freetalk.cli.weights import find_weights


def check(arguments: argparse.Namespace) -> None:
    """Reports what a mesh file holds, what is wrong with it, its unit and pose."""
    file = check_readable(arguments.file, "a mesh (OBJ, PLY, OFF, STL or glTF)")
    import freetalk.mesh

    mesh: Any = freetalk.load_mesh(file)
    report: Any = freetalk.mesh.mesh_report(mesh)
    print(f"{file}: {report.vertices} vertices, {report.triangles} triangles")
    if report.larger_polygons:
        print(f"  polygons: {report.polygons}, {report.larger_polygons} of more than 3 corners")
    print(f"  parts: {report.parts}")
    print(f"  open rims: {report.boundaries}, of {report.boundary_edges} edges")
    extent = " x ".join(f"{length:.4g}" for length in report.extent)
    print(f"  extent: {extent}")
    print(f"  texture coordinates: {'yes' if len(mesh.texcoords) else 'no'}")
    findings = report.findings()
    print("  to know:" if findings else "  to know: nothing, it is a clean mesh")
    for finding in findings:
        print(f"    {finding}")
    if report.zero_area_triangles < report.triangles:
        alignment = align(arguments, np.asarray(mesh.vertices), np.asarray(mesh.faces))
        print(f"  pose: {alignment.summary}")


def align(arguments: argparse.Namespace, vertices: Any, faces: Any) -> Any:
    """Finds unit and pose against the template of the weights, as the command's options say.

    Returns:
        The alignment that `freetalk.geometry.align_to_template` gives.

    Raises:
        ValueError: no such weights.
    """
    import freetalk.geometry
    from freetalk import _native

    template = find_weights(arguments.pretrained) / "template.safetensors"
    tensors = _native.core.load_safetensors(
        check_readable(str(template), "weights with a template")
    )
    return freetalk.geometry.align_to_template(
        vertices,
        faces,
        tensors["points"],
        tensors["normals"],
        unit=arguments.unit,
        up=arguments.up,
        forward=arguments.forward,
    )
