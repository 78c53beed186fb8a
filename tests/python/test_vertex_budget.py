"""Meshes are thinned out and refined to a number of vertices, with their texture, where it matters least and most."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista

import freetalk
from freetalk.cli import main
from freetalk.corpus import assets
from freetalk.mesh import load_appearance, mesh_report, to_vertex_budget
from freetalk.prepare import Prepared, to_budget


def ball(open_below: float = -2.0) -> freetalk.Mesh:
    """A sphere with two charts, front and back, that hold x and y (the back's beside the front's)."""
    sphere = pyvista.Sphere(radius=1.0, theta_resolution=40, phi_resolution=40)
    points, faces = np.asarray(sphere.points, np.float64), sphere.regular_faces
    faces = faces[points[faces].mean(axis=1)[:, 2] > open_below]
    texcoords = np.concatenate([points[:, :2], points[:, :2] + [4.0, 0.0]])
    back = points[faces].mean(axis=1)[:, 1] < 0
    corners = faces + len(points) * back[:, None]
    return freetalk.Mesh(
        points,
        faces.tolist(),
        texcoords=texcoords,
        polygon_texcoords=corners.tolist(),
        name="ball",
    )


def texture_errors(mesh: freetalk.Mesh) -> np.ndarray:
    """(F, 3) how far each corner's texture coordinate is from what its place says, in one chart of a triangle."""
    faces, corners = np.asarray(mesh.faces), np.asarray(mesh.polygon_texcoords)
    places = np.asarray(mesh.vertices)[faces][..., :2]
    texture = np.asarray(mesh.texcoords)[corners]
    errors = [np.linalg.norm(texture - places - [chart, 0.0], axis=-1) for chart in (0.0, 4.0)]
    best = np.argmin([each.max(axis=1) for each in errors], axis=0)
    return np.choose(best[:, None], errors)


@pytest.mark.parametrize("wanted", [500, 4000])
@pytest.mark.parametrize("open_below", [-2.0, -0.6])
def test_the_number_is_met_and_texture_follows(wanted: int, open_below: float) -> None:
    mesh = ball(open_below)
    made = to_vertex_budget(mesh, wanted)
    result = made.mesh
    assert len(result.vertices) == pytest.approx(wanted, abs=2)
    report, before = mesh_report(result), mesh_report(mesh)
    assert (report.boundaries, report.parts) == (before.boundaries, before.parts)
    assert report.zero_area_triangles == 0
    assert report.inconsistent_edges == 0
    now = np.asarray(made.vertex_map)
    np.testing.assert_array_equal(
        np.asarray(result.vertices)[now[now >= 0]], np.asarray(mesh.vertices)[now >= 0]
    )
    assert texture_errors(result).max() < 1e-6
    assert np.abs(np.linalg.norm(result.vertices, axis=1) - 1).max() < 0.02


def test_vertices_are_spent_where_they_matter() -> None:
    mesh = ball()

    def near(points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.asarray(points) - [0, 0, 1], axis=1) < 0.6

    importance = np.where(near(mesh.vertices), 4.0, 1.0)
    for wanted in (600, 4000):
        plain = to_vertex_budget(mesh, wanted).mesh
        focused = to_vertex_budget(mesh, wanted, importance).mesh
        assert len(focused.vertices) == pytest.approx(wanted, abs=2)
        assert near(focused.vertices).sum() > 2 * near(plain.vertices).sum()


def test_polygons_where_the_surface_branches_stay() -> None:
    mesh = ball()
    a, b, _ = np.asarray(mesh.faces)[0]
    fin = [[int(a), int(b), len(mesh.vertices)]]  # a third triangle at an edge
    branching = freetalk.Mesh(
        np.concatenate([mesh.vertices, [[0.0, 0.0, 3.0]]]), np.asarray(mesh.faces).tolist() + fin
    )
    for wanted in (700, 3000):
        made = to_vertex_budget(branching, wanted)
        assert len(made.mesh.vertices) == pytest.approx(wanted, abs=2)
        assert mesh_report(made.mesh).nonmanifold_edges == 1
        assert made.vertex_map[-1] >= 0


def test_colours_and_the_map_follow() -> None:
    mesh = ball()
    points = np.asarray(mesh.vertices)
    colours = np.concatenate([(points + 1) / 2, np.ones((len(points), 1))], axis=1)
    look = load_appearance(mesh).carried([-1] * len(mesh.faces), colours)
    gone_first = np.concatenate([[-1], np.arange(len(points))])
    prepared = Prepared(mesh, gone_first, [], look)
    for wanted in (500, 3000):
        result = to_budget(prepared, wanted)
        places = np.asarray(result.mesh.vertices)
        np.testing.assert_allclose(
            np.asarray(result.appearance.colours)[:, :3], (places + 1) / 2, atol=1e-6
        )
        now = result.vertex_map
        assert now[0] == -1
        kept = np.flatnonzero(now >= 0)
        np.testing.assert_array_equal(places[now[kept]], points[kept - 1])
        assert result.steps == [f"{len(points)} vertices made {len(places)}"]
    assert to_budget(prepared, len(points)) is prepared


def test_other_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match="vertices must be positive, found 0"):
        to_vertex_budget(ball(), 0)
    with pytest.raises(ValueError, match="an importance for each"):
        to_vertex_budget(ball(), 10, [1.0])
    with pytest.raises(ValueError, match="importance must be positive"):
        to_vertex_budget(ball(), 10, np.zeros(len(ball().vertices)))


@pytest.mark.slow
def test_the_command_spends_them_on_the_face(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vertices, faces = assets.mean_face("face")
    freetalk.mesh.save_mesh(
        tmp_path / "face.obj", freetalk.Mesh(vertices, np.asarray(faces).tolist())
    )
    command = ["mesh", "prepare", str(tmp_path / "face.obj"), "--vertices", "3000", "--out"]
    assert main([*command, str(tmp_path / "out.obj")]) == 0
    assert "vertices made 3000" in capsys.readouterr().out
    made = np.asarray(freetalk.load_mesh(tmp_path / "out.obj").vertices)
    mouth = np.asarray(vertices)[assets.load_face_model().landmarks68[48:68]].mean(axis=0)
    share = [
        (np.linalg.norm(points - mouth, axis=1) < 0.025).mean()
        for points in (np.asarray(vertices), made)
    ]
    assert share[1] > 1.3 * share[0]
