"""Lips that are one closed skin are found and cut apart; the rest of the mesh stays as it is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sewn_lips import sewn_head

import freetalk
from freetalk.cli import main
from freetalk.corpus.assets import load_face_model, mean_face
from freetalk.geometry import Similarity
from freetalk.mesh import SlitOptions, cut_lips, lips_are_joined, load_appearance, mesh_report
from freetalk.prepare import open_lips, prepare_mesh

PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc000"
    "0003010100c9fe92ef0000000049454e44ae426082"
)


def closed_head(kind: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, faces, marks = sewn_head({"drawn": 3}.get(kind))
    if kind in ("coarse", "fine"):
        import pyvista

        whole = pyvista.PolyData.from_regular_faces(vertices, faces)
        other = whole.decimate(0.85) if kind == "coarse" else whole.subdivide(1)
        vertices = np.asarray(other.points, np.float64)
        faces = other.regular_faces.astype(np.int64)
    return vertices, faces, marks


@pytest.mark.parametrize("kind", ["mean", "drawn", "coarse", "fine"])
@pytest.mark.slow
def test_a_slit_from_corner_to_corner_leaves_a_manifold(kind: str) -> None:
    vertices, faces, marks = closed_head(kind)
    scan = freetalk.Mesh(vertices, faces.tolist(), name="scan")
    before = mesh_report(scan)
    assert lips_are_joined(vertices, faces, marks)
    slit = cut_lips(scan, marks)
    made = np.asarray(slit.mesh.vertices)
    np.testing.assert_array_equal(made[: len(vertices)], vertices)
    assert len(made) == len(vertices) + len(slit.vertex_origin)
    assert not lips_are_joined(made, np.asarray(slit.mesh.faces), marks)
    after = mesh_report(slit.mesh)
    assert after.nonmanifold_edges == after.nonmanifold_vertices == after.inconsistent_edges == 0
    assert after.boundaries == before.boundaries
    assert after.coincident_vertices == before.coincident_vertices
    opened = cut_lips(scan, marks, options=SlitOptions(depth=0)).mesh
    loops = freetalk.mesh.boundary_loops(np.asarray(opened.faces).tolist())
    rim = min(
        (np.asarray(opened.vertices)[loop] for loop in loops),
        key=lambda points: float(np.linalg.norm(points.mean(axis=0) - marks[60:68].mean(axis=0))),
    )
    assert len(rim) == 2 * slit.edges
    reach = np.array([rim[:, 0].min(), rim[:, 0].max()])
    np.testing.assert_allclose(reach, marks[[60, 64], 0], atol=0.002)


def sheet(rows: int, edge: float, turn: float) -> tuple[freetalk.Mesh, np.ndarray]:
    """A flat mesh of long edges (m) around lips, turned by so many radians; landmarks."""
    vertices, _ = mean_face("face")
    marks = vertices[load_face_model().landmarks68].astype(np.float64)
    middle = marks[60:68].mean(axis=0)
    marks[60:68, 1:] = middle[1:]
    x, y = np.meshgrid(*2 * [(np.arange(rows) - rows // 2) * edge])
    turned = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    points = np.stack([*turned, np.zeros_like(x)], axis=-1).reshape(-1, 3) + middle
    corner = (rows * np.arange(rows - 1)[:, None] + np.arange(rows - 1)).reshape(-1, 1)
    triangles = np.concatenate([corner + [0, 1, rows + 1], corner + [0, rows + 1, rows]])
    return freetalk.Mesh(points, triangles.tolist(), name="sheet"), marks


@pytest.mark.parametrize("rows, edge, turn", [(9, 0.015, 0.0), (9, 0.015, 0.3), (7, 0.02, 0.6)])
def test_edges_much_longer_than_the_lips_are_wide_are_cut_too(
    rows: int, edge: float, turn: float
) -> None:
    mesh, marks = sheet(rows, edge, turn)
    slit = cut_lips(mesh, marks)
    assert mesh_report(slit.mesh).nonmanifold_edges == 0
    assert slit.edges > 40 and len(slit.mesh.vertices) < 10000
    with pytest.raises(RuntimeError, match="cannot be made as short as 1 mm"):
        cut_lips(*sheet(5, 0.025, 0.2))


def test_lips_that_are_apart_stay_as_they_are() -> None:
    vertices, faces = mean_face("face")
    marks = vertices[load_face_model().landmarks68].astype(np.float64)
    assert not lips_are_joined(vertices, faces, marks)
    prepared = prepare_mesh(freetalk.Mesh(vertices, faces.tolist()))
    assert open_lips(prepared, Similarity(), marks) is prepared


@pytest.mark.slow
def test_texture_coordinates_stay_in_place() -> None:
    vertices, faces, marks = sewn_head()
    drawn = vertices[:, :2]
    pose = Similarity(scale=0.001)
    scan = freetalk.Mesh(
        1000 * vertices, faces.tolist(), texcoords=drawn, polygon_texcoords=faces.tolist()
    )
    prepared = open_lips(prepare_mesh(scan), pose, 1000 * marks)
    assert "slit" in prepared.steps[-1]
    mesh = prepared.mesh
    pocket = _pocket_size(vertices, faces, marks)
    skin = mesh.polygons[:-pocket]
    at = np.array([np.asarray(mesh.vertices)[p, :2] for p in skin])
    texture = np.asarray(mesh.texcoords)
    found = np.array([texture[p] for p in mesh.polygon_texcoords[:-pocket]])
    np.testing.assert_allclose(at / 1000, found, atol=2.1e-5)  # the lower rim is 0.02 mm lower


def _pocket_size(vertices: np.ndarray, faces: np.ndarray, marks: np.ndarray) -> int:
    scan = freetalk.Mesh(vertices, faces.tolist())
    with_pocket, without = (
        len(cut_lips(scan, marks, options=SlitOptions(**each)).polygon_origin)
        for each in ({}, {"depth": 0.0})
    )
    return with_pocket - without


@pytest.mark.slow
def test_the_command_cuts_and_keeps_materials_and_colours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vertices, faces, marks = sewn_head()
    shade = 0.5 + 2 * vertices
    lines = ["mtllib scan.mtl"]
    lines += [f"v {' '.join(f'{x:.7f}' for x in (*v, *c))}" for v, c in zip(vertices, shade)]
    lines += [f"vt {v[0]:.7f} {v[1]:.7f}" for v in vertices]
    half = vertices[faces].mean(axis=1)[:, 0] < 0
    for name, mine in (("right", half), ("left", ~half)):
        lines.append(f"usemtl {name}")
        lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in faces[mine]]
    (tmp_path / "scan.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "scan.mtl").write_text(
        "newmtl right\nmap_Kd skin.png\nnewmtl left\nKd 0.5 0.25 0.125\n"
    )
    (tmp_path / "skin.png").write_bytes(PIXEL)
    nearest = [int(np.argmin(np.linalg.norm(vertices - mark, axis=1))) for mark in marks]
    (tmp_path / "marks.json").write_text(json.dumps(nearest))
    assert main(["mesh", "check", str(tmp_path / "scan.obj")]) == 0
    assert "lips: one closed skin" in capsys.readouterr().out
    out = tmp_path / "new" / "head.obj"
    out.parent.mkdir()
    command = ["mesh", "prepare", str(tmp_path / "scan.obj"), "--out", str(out)]
    assert main([*command, "--landmarks", str(tmp_path / "marks.json")]) == 0
    assert "cut between the lips" in capsys.readouterr().out
    mesh = freetalk.load_mesh(out)
    look = load_appearance(mesh)
    material = np.asarray(look.polygon_material)
    middles = np.array([np.asarray(mesh.vertices)[p].mean(axis=0) for p in np.asarray(mesh.faces)])
    side = material[np.asarray(mesh.face_polygon)]
    assert set(side[middles[:, 0] < -0.03]) == {0}
    assert set(side[middles[:, 0] > 0.03]) == {1}
    assert set(side[np.linalg.norm(middles - marks[62] + [0, 0, 0.02], axis=1) < 0.01]) == {2}
    assert (out.parent / "head_skin.png").read_bytes() == PIXEL
    colours = np.asarray(look.colours)[: len(vertices), :3]
    np.testing.assert_allclose(colours, np.clip(shade, 0, 1), atol=1e-6)
    assert main(["mesh", "check", str(out)]) == 0
    assert "one closed skin" not in capsys.readouterr().out
    assert main([*command, "--keep-lips"]) == 0
    assert "cut between" not in capsys.readouterr().out


def test_options_and_landmarks_are_checked() -> None:
    vertices, faces, marks = sewn_head()
    scan = freetalk.Mesh(vertices, faces.tolist())
    with pytest.raises(ValueError, match="edge and corridor must be positive"):
        cut_lips(scan, marks, options=SlitOptions(edge=0))
    with pytest.raises(ValueError, match=r"landmarks \(68, 3\)"):
        cut_lips(scan, marks[:5])
    with pytest.raises(RuntimeError, match="no surface is at the lips"):
        cut_lips(scan, marks + 1.0)
