"""glTF as other programs write it, and as this library does."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import trimesh

import freetalk as ft


def rotation(axis: list[float], angle: float) -> np.ndarray:
    return trimesh.transformations.rotation_matrix(angle, axis)


def test_scenes_written_by_trimesh_are_read_as_trimesh_reads_them(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(2)
    box = trimesh.creation.box()
    scene = trimesh.Scene()
    scene.add_geometry(ball, node_name="ball", transform=rotation([1, 2, 3], 0.7))
    place = rotation([0, 1, 0], -0.3)
    place[:3, 3] = 4, 5, 6
    scene.add_geometry(box, node_name="box", parent_node_name="ball", transform=place)
    for name in ("scene.glb", "scene.gltf"):
        if name.endswith("glb"):
            (tmp_path / name).write_bytes(scene.export(file_type="glb"))
        else:
            for part, content in scene.export(file_type="gltf").items():
                file = tmp_path / (name if part == "model.gltf" else part)
                file.write_bytes(content)
        ours = ft.load_mesh(tmp_path / name)
        theirs = trimesh.load(tmp_path / name, force="scene").to_mesh()
        assert len(ours.faces) == len(theirs.faces) == len(ball.faces) + len(box.faces)

        def corners(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
            """Centres of the faces, sorted: the order of parts is free."""
            centers = np.asarray(vertices)[np.asarray(faces)].mean(1).round(5)
            return centers[np.lexsort(centers.T)]

        # Coordinates are float32 in the file.
        found = corners(ours.vertices, ours.faces)
        assert np.allclose(found, corners(theirs.vertices, theirs.faces), atol=2e-5)


def test_an_animation_saved_as_glb_gives_its_mesh_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(1)
    mesh = ft.Mesh(np.asarray(ball.vertices), ball.faces.tolist(), name="ball")
    motion = 0.01 * rng.standard_normal((4, len(ball.vertices), 3)).astype(np.float32)
    ft.Animation(mesh, motion, fps=30.0).save(tmp_path / "talk.glb")
    again = ft.load_mesh(tmp_path / "talk.glb")
    assert np.allclose(again.vertices, mesh.vertices, atol=1e-6)  # float32
    assert np.array_equal(again.faces, mesh.faces)
    assert ft.mesh.mesh_report(again).findings() == []


def test_names_of_files_beside_a_gltf_are_percent_encoded(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    moves = 0.01 * np.random.default_rng(0).normal(size=(3, len(ball.vertices), 3))
    mesh = ft.Mesh(ball.vertices, ball.faces.tolist())
    sound = ft.Audio(np.zeros(1600, np.float32), 16000)
    talk = ft.Animation(mesh, moves, fps=30, audio=sound)
    for name in ("a%41 #1 ü.gltf", "plain.gltf"):
        talk.save(tmp_path / name)
        content = json.loads((tmp_path / name).read_text())
        (sound_beside,) = content["extensions"]["KHR_audio_emitter"]["audio"]
        for uri, end in (
            (content["buffers"][0]["uri"], ".bin"),
            (sound_beside["uri"], ".speech.wav"),
        ):
            assert unquote(uri) == name.removesuffix(".gltf") + end and not set(uri) & set(" #ü")
        assert len(ft.load_mesh(tmp_path / name).faces) == len(ball.faces)
