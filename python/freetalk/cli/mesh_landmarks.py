"""``freetalk mesh landmarks``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.cli.mesh import align
from freetalk.cli.outputs import check_readable, check_writable

_GROUPS = (
    ("jaw", 0, 17),
    ("brows", 17, 27),
    ("nose", 27, 36),
    ("eyes", 36, 48),
    ("lips", 48, 68),
)
#: Further from the fitted face than this (m), a landmark should be looked at.
_DOUBTFUL_M = 0.005
_SIDE = 900


def run(arguments: argparse.Namespace) -> None:
    """Proposes the 68 landmarks of a template, takes corrections, writes and shows them."""
    file = check_readable(arguments.file, "a mesh (OBJ, PLY, OFF or STL)")
    changes = [_change(text) for text in arguments.set]
    outputs = [Path(arguments.out)] + [Path(p) for p in (arguments.picture,) if p is not None]
    for path in outputs:
        check_writable(path)
    import freetalk
    from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
    from freetalk.data import read_landmarks
    from freetalk.data.landmark_transfer import LinearFace, propose_landmarks, region_masks

    mesh: Any = freetalk.load_mesh(file)
    faces = np.asarray(mesh.faces)
    alignment = align(arguments, mesh.vertices, faces)
    print(f"{file}: {alignment.summary}")
    vertices = alignment.to_canonical.apply(np.asarray(mesh.vertices))
    model, count = load_face_model(), EXTENTS["face"]
    known = LinearFace(
        model.neutral[:count],
        triangulate(crop_quads(model, "face")),
        model.identity_basis[:, :count],
        model.landmarks68,
    )
    proposed = propose_landmarks(vertices, faces, known)
    indices = proposed.indices.copy()
    if arguments.start is not None:
        start = check_readable(arguments.start, "landmarks")
        indices = read_landmarks(start, faces, len(vertices)).indices.copy()
    for landmark, vertex in changes:
        if vertex >= len(vertices):
            raise ValueError(f"--set {landmark}={vertex}: the mesh has {len(vertices)} vertices")
        indices[landmark] = vertex
    _report(proposed, vertices, indices)
    _write_lists(Path(arguments.out), indices, len(vertices))
    if arguments.masks:
        for name, mask in zip(
            ("lip_mask", "upper_mask"), region_masks(vertices, indices, proposed.fit)
        ):
            path = Path(arguments.out).with_name(f"{name}.json")
            path.write_text(json.dumps(mask.tolist()) + "\n")
            print(f"wrote {path} ({len(mask)} vertices)")
    if arguments.picture is not None:
        draw_landmarks(vertices, faces, indices, Path(arguments.picture))
        print(
            f"wrote {arguments.picture}; correct a landmark with --start {arguments.out} --set N=VERTEX"
        )


def draw_landmarks(
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    indices: npt.NDArray[np.int64],
    path: Path,
) -> None:
    """Writes a PNG of a face with numbered landmarks, from the front and from both sides.

    Args:
        vertices: (V, 3) canonical frame, m.
        faces: (F, 3).
        indices: (68,) vertices.
        path: where.

    Raises:
        RuntimeError: no off-screen OpenGL.
    """
    from freetalk.viz import FaceRenderer, Sequence, View, save_image

    points = np.asarray(vertices, dtype=np.float32)
    marks = points[indices]
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


def _report(proposed: Any, vertices: npt.NDArray[Any], indices: npt.NDArray[np.int64]) -> None:
    fit = proposed.fit
    print(
        f"  the built-in face fits to {1000 * fit.residual_m:.1f} mm over {100 * fit.paired:.0f} % of it"
    )
    changed = indices != proposed.indices
    for name, first, stop in _GROUPS:
        distance = 1000 * proposed.distance_m[first:stop]
        note = f", {int(changed[first:stop].sum())} as given" if changed[first:stop].any() else ""
        print(
            f"  {name}: {distance.mean():.1f} mm from the fitted face, at most {distance.max():.1f}{note}"
        )
    doubtful = np.flatnonzero((proposed.distance_m > _DOUBTFUL_M) & ~changed)
    if len(doubtful):
        print(f"  look at {', '.join(map(str, doubtful))}: the fitted face is more than 5 mm away")
    twice = [int(v) for v in np.unique(indices) if (indices == v).sum() > 1]
    if twice:
        print(
            f"  landmarks share a vertex ({', '.join(map(str, twice))}): the mesh is coarse there"
        )


def _write_lists(path: Path, indices: npt.NDArray[np.int64], num_vertices: int) -> None:
    content = {"landmarks": indices.tolist(), "vertices": num_vertices}
    path.write_text(json.dumps(content) + "\n")
    print(f"wrote {path}")
