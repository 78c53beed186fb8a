"""``freetalk mesh``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk import _native
from freetalk._pretrained import find_weights
from freetalk.cli.outputs import check_readable, check_writable


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
    from freetalk.talker.placement import place

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


_GROUPS = (
    ("jaw", 0, 17),
    ("brows", 17, 27),
    ("nose", 27, 36),
    ("eyes", 36, 48),
    ("lips", 48, _native.core.NUM_LANDMARKS),
)
#: Below this confidence a landmark should be looked at.
_DOUBTFUL = 0.3
_SIDE = 900


def landmarks(arguments: argparse.Namespace) -> None:
    """Finds the 68 landmarks of a mesh, takes corrections, writes and shows them."""
    file = check_readable(arguments.file, "a mesh (OBJ, PLY, OFF or STL)")
    changes = [_change(text) for text in arguments.set]
    outputs = [Path(arguments.out)] + [Path(p) for p in (arguments.picture,) if p is not None]
    for path in outputs:
        check_writable(path)
    import freetalk
    from freetalk.data import read_landmarks
    from freetalk.data.landmark_transfer import region_masks
    from freetalk.faces import find_landmarks

    mesh: Any = freetalk.load_mesh(file)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    alignment = align(arguments, vertices, faces)
    print(f"{file}: {alignment.summary}")
    pictures = None if arguments.pictures == "auto" else arguments.pictures == "yes"
    found = find_landmarks(vertices, faces, alignment, pictures=pictures, name=str(file))
    print(f"  {found.summary}")
    upright = found.pose.apply(vertices)
    corners, weights = faces[found.triangles].astype(np.int64), found.weights.copy()
    if arguments.start is not None:
        start = read_landmarks(check_readable(arguments.start, "landmarks"), faces, len(vertices))
        corners, weights = start.vertices.copy(), start.weights.astype(np.float64)
    given = np.full(len(corners), arguments.start is not None)
    for landmark, vertex in changes:
        if vertex >= len(vertices):
            raise ValueError(f"--set {landmark}={vertex}: the mesh has {len(vertices)} vertices")
        corners[landmark], weights[landmark] = vertex, (1.0, 0.0, 0.0)
        given[landmark] = True
    indices = corners[np.arange(len(corners)), weights.argmax(axis=1)]
    confidence = np.where(given, 1.0, found.confidence)
    _report(confidence, given, indices)
    _write_landmarks(Path(arguments.out), corners, weights, confidence, len(vertices))
    if arguments.masks:
        if found.fit is None:
            raise ValueError(f"{file}: the built-in face does not fit it, so it gives no masks")
        for name, mask in zip(
            ("lip_mask", "upper_mask"), region_masks(upright, indices, found.fit)
        ):
            path = Path(arguments.out).with_name(f"{name}.json")
            path.write_text(json.dumps(mask.tolist()) + "\n")
            print(f"wrote {path} ({len(mask)} vertices)")
    if arguments.picture is not None:
        marks = np.einsum("kcd,kc->kd", upright[corners], weights)
        draw_landmarks(upright, faces, marks, Path(arguments.picture))
        print(
            f"wrote {arguments.picture}; correct a landmark with --start {arguments.out} --set N=VERTEX"
        )


def draw_landmarks(
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    landmarks: npt.NDArray[Any],
    path: Path,
) -> None:
    """Writes a PNG of a face with numbered landmarks, from the front and from both sides.

    Args:
        vertices: (V, 3) canonical frame, m.
        faces: (F, 3).
        landmarks: (68, 3) canonical frame, m.
        path: where.

    Raises:
        RuntimeError: no off-screen OpenGL.
    """
    from freetalk.viz import FaceRenderer, Sequence, View, save_image

    points = np.asarray(vertices, dtype=np.float32)
    marks = np.asarray(landmarks, dtype=np.float32)
    still = np.zeros((1, len(points), 3), dtype=np.float32)
    sequence = Sequence(points, np.asarray(faces, dtype=np.int64), still, 1.0, located=True)
    pictures = []
    for yaw in (-40.0, 0.0, 40.0):
        view = View(yaw_deg=yaw, occlusion=False, fill_openings=False)
        with FaceRenderer(sequence, (_SIDE, _SIDE), view) as renderer:
            # A little outside the surface, so that what is seen from here is in front of it.
            toward = np.array([np.sin(np.deg2rad(yaw)), 0.0, np.cos(np.deg2rad(yaw))])
            renderer.plotter.add_point_labels(
                marks + 0.003 * toward,
                [str(number) for number in range(len(marks))],
                font_size=15,
                text_color="#10151c",
                point_color="#d2402c",
                point_size=9,
                render_points_as_spheres=True,
                shape=None,
                always_visible=False,
            )
            pictures.append(renderer.image(points))
    save_image(np.concatenate(pictures, axis=1), path)


def _change(text: str) -> tuple[int, int]:
    landmark, equals, vertex = text.partition("=")
    if not equals or not landmark.isdecimal() or not vertex.isdecimal() or int(landmark) > 67:
        raise ValueError(
            f"--set {text}: write LANDMARK=VERTEX, such as 48=1532; landmarks are 0 to 67"
        )
    return int(landmark), int(vertex)


def _report(
    confidence: npt.NDArray[np.float64],
    given: npt.NDArray[np.bool_],
    indices: npt.NDArray[np.int64],
) -> None:
    for name, first, stop in _GROUPS:
        sure = confidence[first:stop]
        note = f", {int(given[first:stop].sum())} as given" if given[first:stop].any() else ""
        print(f"  {name}: confidence {sure.mean():.2f}, least {sure.min():.2f}{note}")
    doubtful = np.flatnonzero((confidence < _DOUBTFUL) & ~given)
    if len(doubtful):
        print(f"  look at {', '.join(map(str, doubtful))}: they may be elsewhere")
    twice = [int(v) for v in np.unique(indices) if (indices == v).sum() > 1]
    if twice:
        print(
            f"  landmarks share a vertex ({', '.join(map(str, twice))}): the mesh is coarse there"
        )


def _write_landmarks(
    path: Path,
    corners: npt.NDArray[np.int64],
    weights: npt.NDArray[np.float64],
    confidence: npt.NDArray[np.float64],
    num_vertices: int,
) -> None:
    """Writes the landmarks as vertices and, exactly, as weighted means of three."""
    indices = corners[np.arange(len(corners)), weights.argmax(axis=1)]
    content = {
        "landmarks": indices.tolist(),
        "corners": corners.tolist(),
        "weights": np.round(weights, 6).tolist(),
        "confidence": np.round(confidence, 3).tolist(),
        "vertices": num_vertices,
    }
    path.write_text(json.dumps(content) + "\n")
    print(f"wrote {path}")
