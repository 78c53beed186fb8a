"""Damaged meshes come out repaired, with the map of old to new vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import freetalk
from freetalk.cli import main
from freetalk.mesh import mesh_report
from freetalk.prepare import prepare_mesh


def ball() -> tuple[np.ndarray, np.ndarray]:
    import pyvista

    sphere = pyvista.Sphere(radius=1.0, theta_resolution=24, phi_resolution=24)
    return np.asarray(sphere.points, np.float64), sphere.regular_faces.astype(np.int64)


def volume(mesh: freetalk.Mesh) -> float:
    a, b, c = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].transpose(1, 0, 2)
    return float(np.einsum("fd,fd->", a, np.cross(b, c))) / 6


def test_winding_is_turned_outward_and_made_one() -> None:
    vertices, faces = ball()
    wrong = faces[:, ::-1].copy()
    wrong[::3] = wrong[::3, ::-1]
    prepared = prepare_mesh(freetalk.Mesh(vertices, wrong.tolist()))
    assert mesh_report(prepared.mesh).inconsistent_edges == 0
    assert volume(prepared.mesh) == pytest.approx(4 / 3 * np.pi, rel=0.05)
    assert prepare_mesh(prepared.mesh).steps == []


def test_floating_bits_and_duplicates_go_and_the_map_says_where_vertices_went() -> None:
    vertices, faces = ball()
    bit = np.array([[3.0, 0, 0], [3.1, 0, 0], [3.0, 0.1, 0]])
    points = np.concatenate([bit, vertices])
    polygons = [[0, 1, 2], *(faces + 3).tolist(), *(faces[:5] + 3).tolist(), [7, 7, 8]]
    prepared = prepare_mesh(freetalk.Mesh(points, polygons))
    assert len(prepared.mesh.faces) == len(faces)
    assert (prepared.vertex_map[:3] == -1).all()
    kept = prepared.vertex_map[3:]
    np.testing.assert_array_equal(np.asarray(prepared.mesh.vertices)[kept], vertices)
    assert len(prepared.steps) == 3
    whole = prepare_mesh(freetalk.Mesh(points, polygons), floating=0, duplicates=False)
    assert len(whole.mesh.faces) == len(polygons)


def test_holes_up_to_a_size_are_closed() -> None:
    vertices, faces = ball()
    holed = np.delete(faces, [100, 300, 301, 302, 303], axis=0)
    mesh = freetalk.Mesh(vertices, holed.tolist())
    small = prepare_mesh(mesh, holes=3)
    assert mesh_report(small.mesh).boundaries == mesh_report(mesh).boundaries - 1
    closed = prepare_mesh(mesh, holes=20)
    report = mesh_report(closed.mesh)
    assert report.boundary_edges == 0
    assert report.inconsistent_edges == 0


def test_options_out_of_range_and_an_empty_result_are_errors() -> None:
    vertices, faces = ball()
    mesh = freetalk.Mesh(vertices, faces.tolist())
    with pytest.raises(ValueError, match="floating must be"):
        prepare_mesh(mesh, floating=1.5)
    with pytest.raises(ValueError, match="no polygon is left"):
        prepare_mesh(freetalk.Mesh(vertices[:3], [[0, 1, 1]]))


@pytest.mark.slow
def test_the_command_keeps_texture_coordinates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vertices, faces = ball()
    textured = freetalk.Mesh(
        vertices,
        faces[:, ::-1].tolist(),
        texcoords=vertices[:, :2],
        polygon_texcoords=faces[:, ::-1].tolist(),
    )
    freetalk.mesh.save_mesh(tmp_path / "scan.obj", textured)
    out, record = tmp_path / "head.obj", tmp_path / "map.npy"
    command = ["mesh", "prepare", str(tmp_path / "scan.obj"), "--out", str(out)]
    assert main([*command, "--map", str(record)]) == 0
    assert "polygons turned outward" in capsys.readouterr().out
    mesh = freetalk.load_mesh(out)
    at = np.asarray(mesh.vertices)[np.asarray(mesh.faces)][:, :, :2]
    drawn = np.asarray(mesh.texcoords)[np.asarray(mesh.polygon_texcoords)]
    np.testing.assert_allclose(at, drawn, atol=1e-6)
    np.testing.assert_array_equal(np.load(record), np.arange(len(vertices)))


def test_fbx_says_how_to_convert_it(tmp_path: Path) -> None:
    (tmp_path / "head.fbx").write_bytes(b"Kaydara FBX Binary")
    with pytest.raises(RuntimeError, match=r"head\.fbx is FBX.*glTF"):
        freetalk.load_mesh(tmp_path / "head.fbx")
