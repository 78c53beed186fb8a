"""Teeth, tongue and eyeballs for faces without: where there is an opening for them, behind the skin, kept through files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from sewn_lips import sewn_head
from test_slit import PIXEL

import freetalk
from freetalk.animation import Parts
from freetalk.cli import main
from freetalk.corpus.assets import load_face_model, mean_face
from freetalk.geometry import Similarity
from freetalk.mesh import load_appearance, load_mesh
from freetalk.prepare import add_inner_parts, open_lips, open_mouth, prepare_mesh, save_prepared


def marks_of(vertices: np.ndarray) -> np.ndarray:
    return vertices[load_face_model().landmarks68].astype(np.float64)


def test_an_open_face_gets_eyes_and_a_mouth_that_move_as_they_should() -> None:
    vertices, faces = mean_face("face")
    scan = freetalk.Mesh(1000 * vertices.astype(np.float64), faces.tolist(), name="scan")
    marks = marks_of(vertices)
    made = add_inner_parts(prepare_mesh(scan), Similarity(scale=0.001), 1000 * marks)
    assert made.steps[-2:] == ["2 eyeballs added", "teeth, gums and tongue added"]
    np.testing.assert_array_equal(np.asarray(made.mesh.vertices)[: len(vertices)], scan.vertices)
    home = np.asarray(made.mesh.vertices) / 1000
    parts = Parts(home, made.mesh.faces, marks)
    share = np.asarray(parts.jaw_share)[len(vertices) :]
    assert (share == 1).sum() > 1500 and (share == 0).sum() > 4000
    added = home[len(vertices) :]
    teeth = added[(added[:, 2] > 0.0) & (np.abs(added[:, 0]) < 0.012) & (added[:, 1] < -0.005)]
    assert len(teeth) > 100
    near = home[: len(vertices)]
    for point in teeth[::10]:
        before = np.linalg.norm(near[:, :2] - point[:2], axis=1) < 0.004
        assert point[2] < near[before, 2].max() - 0.001


@pytest.mark.slow
def test_lips_that_were_cut_get_teeth_and_closed_ones_none() -> None:
    vertices, faces, marks = sewn_head()
    closed = prepare_mesh(freetalk.Mesh(vertices, faces.tolist()))
    assert "the mouth is no opening" in add_inner_parts(closed, Similarity(), marks).steps[-1]
    cut = open_lips(closed, Similarity(), marks, depth=0.0)
    made = add_inner_parts(cut, Similarity(), marks)
    assert made.steps[-1] == "teeth, gums and tongue added"
    assert len(made.mesh.vertices) > len(cut.mesh.vertices) + 9000


@pytest.mark.slow
def test_a_mouth_that_is_closed_behind_the_lips_is_opened() -> None:
    vertices, faces, marks = sewn_head()
    closed = prepare_mesh(freetalk.Mesh(vertices, faces.tolist()))
    assert open_mouth(closed, Similarity(), marks) is closed  # lips that are one skin
    bag = open_lips(closed, Similarity(), marks)
    assert "the mouth is no opening" in add_inner_parts(bag, Similarity(), marks).steps[-1]
    opened = open_mouth(bag, Similarity(), marks)
    assert "the mouth opened behind the lips" in opened.steps[-1]
    left, before = np.asarray(opened.mesh.vertices), np.asarray(bag.mesh.vertices)
    now = opened.vertex_map[: len(vertices)]
    assert (now >= 0).mean() > 0.99
    np.testing.assert_array_equal(left[now[now >= 0]], vertices[now >= 0])
    assert len(left) < len(before) - 150  # most of the bag
    assert add_inner_parts(opened, Similarity(), marks).steps[-1] == "teeth, gums and tongue added"
    face, faces = mean_face("face")
    ready = prepare_mesh(freetalk.Mesh(face.astype(np.float64), faces.tolist()))
    assert open_mouth(ready, Similarity(), marks_of(face)) is ready


@pytest.mark.slow
def test_a_textured_gltf_keeps_its_look_and_gains_parts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    vertices, faces = mean_face("head")
    lines = ["mtllib face.mtl", "usemtl painted"]
    lines += [f"v {' '.join(f'{x:.7f}' for x in v)}" for v in vertices]
    lines += [f"vt {v[0] + 0.5:.7f} {v[1] + 0.5:.7f}" for v in vertices]
    lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in faces]
    (tmp_path / "face.obj").write_text("\n".join(lines))
    (tmp_path / "face.mtl").write_text("newmtl painted\nKd 1 0.5 0.25\nmap_Kd skin.png\n")
    (tmp_path / "skin.png").write_bytes(PIXEL)
    save_prepared(tmp_path / "face.glb", prepare_mesh(load_mesh(tmp_path / "face.obj")))
    landmarks = tmp_path / "landmarks.json"
    landmarks.write_text(json.dumps(load_face_model().landmarks68.tolist()))
    out = tmp_path / "head.glb"
    main(
        ["mesh", "prepare", str(tmp_path / "face.glb"), "--parts", "--landmarks", str(landmarks)]
        + ["--out", str(out)]
    )
    assert "teeth, gums and tongue added" in capsys.readouterr().out
    content = out.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    look = {material["name"]: material for material in document["materials"]}
    assert {"painted", "teeth", "gums", "mouth", "eye", "iris", "pupil"} <= look.keys()
    painted = look["painted"]["pbrMetallicRoughness"]
    assert painted["baseColorFactor"][:3] == pytest.approx([1, 0.5, 0.25])
    assert "baseColorTexture" in painted and PIXEL in content
    mesh = load_mesh(out)
    materials = np.asarray(load_appearance(mesh).polygon_material)
    assert (materials == list(look).index("painted")).sum() == len(faces)
    assert len(mesh.texcoords) >= len(vertices)
    main(["mesh", "prepare", str(out), "--keep-lips", "--out", str(tmp_path / "again.obj")])
    assert (tmp_path / "again.mtl").read_text().count("newmtl") == len(look)


def test_colours_of_vertices_come_out_of_gltf_as_they_went_in(tmp_path: Path) -> None:
    vertices, faces = mean_face("narrow")
    shade = np.clip(0.5 + 4 * vertices, 0, 1)
    lines = [f"v {' '.join(f'{x:.7f}' for x in (*v, *c))}" for v, c in zip(vertices, shade)]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces]
    (tmp_path / "face.obj").write_text("\n".join(lines))
    save_prepared(tmp_path / "face.glb", prepare_mesh(load_mesh(tmp_path / "face.obj")))
    found = np.asarray(load_appearance(load_mesh(tmp_path / "face.glb")).colours)
    np.testing.assert_allclose(found[:, :3], shade, atol=0.006)
