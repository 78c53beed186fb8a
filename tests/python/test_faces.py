"""The face on a mesh is found in any unit and pose, on whole characters too, and not where there is none."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import freetalk
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, mean_face, triangulate
from freetalk.faces import NoFaceError, available, find_landmarks
from freetalk.faces.points import eye_distance, load_face_points
from freetalk.faces.sighting import fit_pose, lift
from freetalk.faces.views import Camera, SurfaceViews, facing
from freetalk.geometry import Similarity, align_to_template, sample_template

needs_pictures = pytest.mark.skipif(not available(), reason="the extra 'faces' is not installed")

Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


def turned(vertices: np.ndarray, seed: int, scale: float) -> Similarity:
    """A random rotation with a scale and a place."""
    rng = np.random.default_rng(seed)
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    q[:, 0] *= np.sign(np.linalg.det(q))
    return Similarity(scale, q, translation=scale * rng.normal(size=3))


@lru_cache(maxsize=1)
def head() -> Arrays:
    """A drawn head with neck: vertices (V, 3) m, triangles, landmarks (68, 3)."""
    model, count = load_face_model(), EXTENTS["head"]
    modes = model.identity_basis[:, :count]
    drawn = 0.8 * np.random.default_rng(3).standard_normal(len(modes))
    vertices = (model.neutral[:count] + np.tensordot(drawn, modes, axes=1)).astype(np.float64)
    return vertices, triangulate(crop_quads(model, "head")), vertices[model.landmarks68]


def character() -> Arrays:
    """That head on a body of 1.75 m with stretched arms, made of boxes."""
    import pyvista

    vertices, faces, landmarks = head()
    points, triangles = [vertices], [faces]
    for low, high in (
        ((-0.2, -0.75, -0.2), (0.2, -0.17, 0.05)),
        ((-0.85, -0.30, -0.15), (0.85, -0.20, -0.02)),
        ((-0.17, -1.55, -0.16), (-0.03, -0.75, 0.0)),
        ((0.03, -1.55, -0.16), (0.17, -0.75, 0.0)),
    ):
        box = pyvista.Box((low[0], high[0], low[1], high[1], low[2], high[2]), level=8, quads=False)
        box = box.triangulate().clean()
        triangles.append(box.regular_faces + sum(len(p) for p in points))
        points.append(np.asarray(box.points, dtype=np.float64))
    return np.concatenate(points), np.concatenate(triangles), landmarks


def found_on(vertices: np.ndarray, faces: np.ndarray, pictures: bool | None = None):
    mean, triangles = mean_face("face")
    points, normals = sample_template(mean, triangles)
    alignment = align_to_template(vertices, faces, points, normals)
    return find_landmarks(vertices, faces, alignment, pictures=pictures)


@needs_pictures
@pytest.mark.parametrize(("seed", "scale"), [(1, 100.0), (2, 0.37)])
def test_a_head_is_found_in_any_pose_and_unit(seed: int, scale: float) -> None:
    vertices, faces, landmarks = head()
    placed = turned(vertices, seed, scale)
    found = found_on(placed.apply(vertices), faces)
    error = np.linalg.norm(found.positions - placed.apply(landmarks), axis=1)
    assert error.mean() < 0.02 * eye_distance(placed.apply(landmarks))
    # A large head in one unit is a small one in another: heads differ by as much.
    assert found.pose.scale == pytest.approx(1 / scale, rel=0.15)
    assert found.confidence[36:].mean() > 0.7
    on_surface = np.einsum(
        "kcd,kc->kd", placed.apply(vertices)[faces[found.triangles]], found.weights
    )
    np.testing.assert_allclose(found.positions, on_surface, atol=1e-9 * scale)


@needs_pictures
def test_the_face_of_a_whole_character_is_found() -> None:
    vertices, faces, landmarks = character()
    placed = turned(vertices, 5, 40.0)
    found = found_on(placed.apply(vertices), faces)
    error = np.linalg.norm(found.positions - placed.apply(landmarks), axis=1)
    assert error.mean() < 0.03 * eye_distance(placed.apply(landmarks))


@needs_pictures
def test_a_mesh_wound_inside_out_has_its_face() -> None:
    vertices, faces, landmarks = head()
    found = found_on(100 * vertices, faces[:, ::-1])
    error = np.linalg.norm(found.positions - 100 * landmarks, axis=1)
    assert error.mean() < 0.02 * eye_distance(100 * landmarks)


@pytest.mark.parametrize("pictures", [False, pytest.param(True, marks=needs_pictures)])
def test_what_is_no_face_is_refused_in_one_sentence(pictures: bool) -> None:
    import pyvista

    knot = pyvista.ParametricTorus(ringradius=0.3, crosssectionradius=0.1).triangulate().clean()
    with pytest.raises(NoFaceError, match=r"does not look like a face: none .* forward$"):
        found_on(np.asarray(knot.points, np.float64), knot.regular_faces, pictures)


def test_without_pictures_the_shape_is_asked() -> None:
    vertices, faces, landmarks = head()
    found = found_on(100 * vertices, faces, pictures=False)
    error = np.linalg.norm(found.positions - 100 * landmarks, axis=1)
    assert error.mean() < 0.02 * eye_distance(100 * landmarks)


def test_points_of_a_picture_are_cast_back_onto_the_surface() -> None:
    vertices, faces, _ = head()
    camera = Camera(np.zeros(3), facing(np.array([0.3, 0.1, 1.0])), 0.15)
    reference = load_face_points().mean
    with SurfaceViews(vertices, faces) as views:
        places = views.nearest(reference)[0]
        local = camera.project(places)
        seen = np.column_stack(
            [(local[:, 0] + 1) / 2, (1 - local[:, 1]) / 2, -local[:, 2] / (2 * camera.half)]
        )
        points, weights = lift(views.shoot(camera), seen)
    off = np.linalg.norm(points - places, axis=1)
    assert np.median(off[weights > 0.3]) < 0.0005
    assert (weights > 0.3).mean() > 0.5


def test_a_turned_camera_gives_the_turned_picture() -> None:
    vertices, faces, _ = head()
    camera = Camera(np.zeros(3), facing(np.array([0.2, 0.3, 1.0])), 0.2)
    with SurfaceViews(vertices, faces, side=64) as views:
        upright = views.shoot(camera).nearness
        turned_picture = views.shoot(camera.turned(1)).nearness
    both = np.isfinite(np.rot90(upright)) & np.isfinite(turned_picture)
    assert both.mean() > 0.2
    assert np.abs(np.rot90(upright) - turned_picture)[both].mean() < 0.002


def test_a_pose_is_robust_to_points_that_are_elsewhere() -> None:
    reference = load_face_points().mean
    home = turned(reference, 4, 3.0)
    points = home.inverse().apply(reference)
    points[::10] += 0.01  # 3 cm on the face
    pose = fit_pose(points, reference, np.ones(len(points)))
    np.testing.assert_allclose(pose.rotation, home.rotation, atol=0.02)
    assert pose.scale == pytest.approx(home.scale, rel=0.02)


@needs_pictures
def test_the_command_finds_the_face_of_a_lying_head(tmp_path: Path, capsys) -> None:
    import json

    from freetalk.cli import main

    vertices, faces, landmarks = head()
    placed = turned(vertices, 9, 100.0)
    mesh = freetalk.Mesh(placed.apply(vertices), faces.tolist())
    freetalk.mesh.save_mesh(tmp_path / "head.ply", mesh)
    out = tmp_path / "marks.json"
    assert main(["mesh", "landmarks", str(tmp_path / "head.ply"), "--out", str(out)]) == 0
    assert "face seen in 100%" in capsys.readouterr().out
    content = json.loads(out.read_text())
    places = np.einsum(
        "kcd,kc->kd", placed.apply(vertices)[content["corners"]], np.array(content["weights"])
    )
    error = np.linalg.norm(places - placed.apply(landmarks), axis=1)
    assert error.mean() < 0.02 * eye_distance(placed.apply(landmarks))
    assert len(content["confidence"]) == 68
