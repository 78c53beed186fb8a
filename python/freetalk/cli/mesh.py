"""``freetalk mesh``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from freetalk.cli.outputs import check_readable, check_writable
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
        if alignment.face_like and _lips_joined(arguments, mesh, alignment):
            print(
                "  lips: one closed skin, which stretches where a mouth should open: 'freetalk mesh prepare' cuts "
                "them apart"
            )


def _lips_joined(arguments: argparse.Namespace, mesh: Any, alignment: Any) -> bool:
    from freetalk.mesh import lips_are_joined

    home = alignment.to_canonical.apply(np.asarray(mesh.vertices))
    return lips_are_joined(home, np.asarray(mesh.faces), _template(arguments)["landmarks68"])


def prepare(arguments: argparse.Namespace) -> None:
    """Repairs a mesh file, says what was done and writes it."""
    file = check_readable(arguments.file, "a mesh (OBJ, PLY, OFF, STL or glTF)")
    outputs = [Path(path) for path in (arguments.out, arguments.map) if path is not None]
    for path in outputs:
        check_writable(path)
    import freetalk
    from freetalk._files import replacing
    from freetalk.prepare import prepare_mesh, save_prepared

    prepared = prepare_mesh(
        freetalk.load_mesh(file),
        duplicates=not arguments.keep_duplicates,
        floating=arguments.floating,
        winding=not arguments.keep_winding,
        holes=arguments.holes,
    )
    if arguments.parts or arguments.vertices or not arguments.keep_lips:
        prepared = _on_the_face(arguments, prepared)
    for step in prepared.steps or ["nothing to repair"]:
        print(f"  {step}")
    save_prepared(arguments.out, prepared)
    print(f"wrote {arguments.out}: {len(prepared.mesh.vertices)} vertices")
    if arguments.map is not None:
        with replacing(Path(arguments.map)) as temporary, temporary.open("wb") as stream:
            np.save(stream, prepared.vertex_map)
        print(f"wrote {arguments.map}")


def _on_the_face(arguments: argparse.Namespace, prepared: Any) -> Any:
    """The mesh with its vertices where the face is, lips apart and what is behind them; says why not where no face is
    found on it."""
    from freetalk.faces import find_landmarks
    from freetalk.prepare import add_inner_parts, open_lips, open_mouth, to_budget
    from freetalk.talker.where import place

    mesh = prepared.mesh
    if arguments.landmarks is not None:
        placed = place(mesh, check_readable(arguments.landmarks, "landmarks"))
        pose, marks = placed.to_canonical, placed.to_canonical.inverse().apply(placed.landmarks)
    else:
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        try:
            found = find_landmarks(vertices, faces, align(arguments, vertices, faces))
        except ValueError as error:
            print(f"  lips and eyes were not looked at: {error}")
            return to_budget(prepared, arguments.vertices) if arguments.vertices else prepared
        print(f"  {found.summary}")
        pose, marks = found.pose, found.positions
    if arguments.vertices:
        prepared = to_budget(prepared, arguments.vertices, pose, marks)
    if not arguments.keep_lips:
        depth = {"depth": 0.0} if arguments.parts or arguments.no_inner_mouth else {}
        prepared = open_lips(prepared, pose, marks, **depth)
    if not arguments.parts:
        return prepared
    return add_inner_parts(open_mouth(prepared, pose, marks), pose, marks)


def align(arguments: argparse.Namespace, vertices: Any, faces: Any) -> Any:
    """Finds unit and pose against the template of the weights, as the command's options say.

    Returns:
        The alignment that `freetalk.geometry.align_to_template` gives.

    Raises:
        ValueError: no such weights.
    """
    import freetalk.geometry

    tensors = _template(arguments)
    return freetalk.geometry.align_to_template(
        vertices,
        faces,
        tensors["points"],
        tensors["normals"],
        unit=arguments.unit,
        up=arguments.up,
        forward=arguments.forward,
    )


def _template(arguments: argparse.Namespace) -> dict[str, Any]:
    """The mean face of the weights: points, normals, landmarks68."""
    from freetalk import _native

    file = find_weights(arguments.pretrained) / "template.safetensors"
    return _native.core.load_safetensors(check_readable(str(file), "weights with a template"))
