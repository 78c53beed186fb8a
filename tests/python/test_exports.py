"""Exports read back by other programs: usd-core, trimesh, Blender where it is installed, and our own readers."""

from __future__ import annotations

import csv
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from test_animation import face_animation

import freetalk
from freetalk.animation import Animation, BlendShapes
from freetalk.cli.app import main
from freetalk.corpus import assets
from freetalk.exports import blender_script, load_curves, save_curves
from freetalk.exports.curves import CSV_NAMES
from freetalk.rig import RigPoses
from freetalk.viz.sequence import as_sequence

MM = 1e3
POSES = Path(freetalk.__file__).parent / "pretrained/open-small/rig_poses.safetensors"
BLENDER = os.environ.get("FREETALK_BLENDER_PYTHON", "")
"""Python of an environment of its own in which ``pip install bpy`` was run."""


def world(animation: Animation) -> np.ndarray:
    """(T, V, 3) metres, +Y up."""
    frame = animation.frame
    vertices = np.stack([animation.vertices_at(index) for index in range(animation.num_frames)])
    return vertices @ np.asarray(frame.to_y_up).T * frame.metres_per_unit


def error_mm(found: np.ndarray, animation: Animation) -> float:
    expected = world(animation)
    return float(np.linalg.norm(found[:, : expected.shape[1]] - expected, axis=-1).max() * MM)


def with_head(animation: Animation) -> Animation:
    """The same with a head that turns about a slanting axis and leans."""
    turns = np.linspace(0, 0.3, animation.num_frames)
    head = np.tile(np.eye(4), (animation.num_frames, 1, 1))
    head[:, :3, :3] = Rotation.from_rotvec(np.outer(turns, [0.5, 0.7, -0.4])).as_matrix()
    head[:, :3, 3] = np.outer(turns, [0.02, -0.01, 0.03]) / animation.frame.metres_per_unit
    return Animation(
        animation.mesh,
        animation.displacements,
        fps=animation.fps,
        audio=animation.audio,
        metres_per_unit=animation.frame.metres_per_unit,
        to_y_up=animation.frame.to_y_up,
        head=head,
    )


def textured_animation(folder: Path) -> Animation:
    """A face from an OBJ with a texture and two materials, in centimetres, +Z up."""
    still = face_animation(25)
    turn = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    vertices = still.vertices @ turn
    lines = ["mtllib face.mtl"] + [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    lines += [f"vt {0.5 + x / 30:.6f} {0.5 + z / 30:.6f}" for x, _, z in vertices]
    for index, face in enumerate(still.faces + 1):
        if index in (0, 4000):
            lines.append(f"usemtl part{index}")
        lines.append("f " + " ".join(f"{v}/{v}" for v in face))
    (folder / "face.obj").write_text("\n".join(lines))
    (folder / "face.mtl").write_text("newmtl part0\nmap_Kd skin.png\nnewmtl part4000\nKd 1 0 0\n")
    from PIL import Image

    Image.new("RGB", (8, 8), (200, 160, 140)).save(folder / "skin.png")
    return Animation(
        freetalk.load_mesh(folder / "face.obj"),
        still.displacements @ torch.from_numpy(turn).float(),
        fps=25,
        audio=freetalk.Audio(np.sin(np.arange(16000, dtype=np.float32)), 16000),
        metres_per_unit=0.01,
        to_y_up=turn,
    )


@pytest.mark.parametrize("head", [False, True])
@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.usda", "a.usdc", "A.USDZ", "a.usd"])
def test_what_is_written_comes_back(tmp_path: Path, name: str, head: bool) -> None:
    if "usd" in name.lower():
        pytest.importorskip("pxr")
    animation = textured_animation(tmp_path)
    if head:
        animation = with_head(animation)
    report = animation.save(tmp_path / name)
    found = freetalk.load_animation(tmp_path / name)
    error = error_mm(world(found), animation)
    print(f"{name}: {error:.5f} mm, stated {report.morph_error_mm:.5f}")
    assert error <= report.morph_error_mm + 0.001
    assert report.morph_error_mm <= 0.1
    assert found.fps == pytest.approx(25)
    assert len(found.audio.samples) == 16000
    assert not list(tmp_path.glob(".*"))
    assert (found.head is not None) == head  # a transform of its own, not part of the targets
    if head:
        rest = found.displacements.abs().amax() / animation.displacements.abs().amax()
        assert rest == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("name", ["a.glb", "a.usda"])
def test_the_face_lies_where_a_file_says(tmp_path: Path, name: str) -> None:
    if "usd" in name:
        pytest.importorskip("pxr")
    talking = face_animation(3)
    turn = Rotation.from_euler("xyz", [0.1, 0.2, -1.4]).as_matrix()
    pose = {"scale": 0.0098, "rotation": turn.tolist(), "translation": [0.01, -0.02, 0.03]}
    animation = Animation(
        talking.mesh,
        talking.displacements,
        fps=25,
        metres_per_unit=0.01,
        to_y_up=np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
        metadata={"alignment": {"unit": "cm", "to_canonical": pose}},
    )
    animation.save(tmp_path / name)
    expected, found = (
        as_sequence(each) for each in (animation, freetalk.load_animation(tmp_path / name))
    )
    np.testing.assert_allclose(
        found.upright(found.vertices), expected.upright(expected.vertices), atol=1e-6
    )


@pytest.mark.parametrize("name", ["a.glb", "a.usda", "a.usdc"])
def test_a_head_that_moves_in_silence_comes_back(tmp_path: Path, name: str) -> None:
    if "usd" in name:
        pytest.importorskip("pxr")
    talking = face_animation(5)
    still = Animation(talking.mesh, 0 * talking.displacements, fps=25, metres_per_unit=0.01)
    animation = with_head(still)
    animation.save(tmp_path / name)
    assert error_mm(world(freetalk.load_animation(tmp_path / name)), animation) < 1e-3


def test_files_of_vertices_hold_the_motion_of_the_head(tmp_path: Path) -> None:
    animation = with_head(face_animation(6))
    animation.save(tmp_path / "a.pc2")
    animation.save(tmp_path / "frames/*.ply")
    cached = Animation.load(tmp_path / "a.pc2", mesh=animation.mesh, fps=25)
    frames = Animation.load(tmp_path / "frames", fps=25)
    for found in (cached, frames):
        np.testing.assert_allclose(found.vertices_at(5), animation.vertices_at(5), atol=1e-5)


def test_the_head_carries_a_character_but_not_the_lamps(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    first = face_animation(3)
    first.save(tmp_path / "plain.glb")
    document = pygltflib.GLTF2().load(str(tmp_path / "plain.glb"))
    document.animations.clear()
    document.nodes.append(pygltflib.Node(name="lamp", translation=[0, 1, 0]))
    document.scenes[0].nodes.append(1)
    document.save(str(tmp_path / "character.glb"))
    mesh = freetalk.load_mesh(tmp_path / "character.glb")
    talking = Animation(mesh, 0.01 * first.displacements, fps=25)
    animation = with_head(talking)
    assert animation.save(tmp_path / "talk.glb").into_source
    made = pygltflib.GLTF2().load(str(tmp_path / "talk.glb"))
    assert [made.nodes[n].name for n in made.scenes[0].nodes] == ["lamp", "head"]
    assert made.nodes[2].children == [0]
    found = freetalk.load_animation(tmp_path / "talk.glb")
    assert found.head is not None
    assert error_mm(world(found), animation) <= 0.101


@pytest.mark.parametrize("head", [False, True])
def test_a_point_cache_is_exact(tmp_path: Path, head: bool) -> None:
    pytest.importorskip("pxr")
    animation = textured_animation(tmp_path)
    if head:
        animation = with_head(animation)
    animation.save(tmp_path / "a.usdc", cache=True)
    assert error_mm(world(freetalk.load_animation(tmp_path / "a.usdc")), animation) < 1e-3


@pytest.mark.parametrize("head", [False, True])
def test_usd_is_what_usd_expects(tmp_path: Path, head: bool) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom, UsdShade, UsdSkel, UsdValidation

    animation = textured_animation(tmp_path)
    if head:
        animation = with_head(animation)
    animation.save(tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert stage.GetEndTimeCode() == 24 and stage.GetTimeCodesPerSecond() == 25
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Face/Surface"))
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == len(animation.faces)
    st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").ComputeFlattened()
    assert len(st) == 3 * len(animation.faces)
    shapes = UsdSkel.BindingAPI(mesh.GetPrim()).GetBlendShapesAttr().Get()
    assert 3 <= len(shapes) <= 8
    subsets = UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
    assert sum(len(s.GetIndicesAttr().Get()) for s in subsets) == len(animation.faces)
    assert (tmp_path / "a.textures" / "skin.png").is_file()
    rules = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = UsdValidation.ValidationContext(rules).Validate(stage)
    assert not [problem.GetMessage() for problem in problems]


def test_glb_keeps_materials_for_trimesh(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    textured_animation(tmp_path).save(tmp_path / "a.glb")
    parts = trimesh.load(tmp_path / "a.glb", process=False).geometry.values()
    looks = {part.visual.material.name: part.visual for part in parts}
    assert looks["part0"].material.baseColorTexture.size == (8, 8)
    assert looks["part0"].uv.shape[1] == 2
    assert tuple(looks["part4000"].material.baseColorFactor[:3]) == (255, 0, 0)


def test_compact_is_half_the_size(tmp_path: Path) -> None:
    animation = face_animation()
    plain = animation.save(tmp_path / "a.glb", sound=False)
    small = animation.save(tmp_path / "b.glb", sound=False, compact=True)
    sizes = [(tmp_path / name).stat().st_size for name in ("a.glb", "b.glb")]
    found = freetalk.load_animation(tmp_path / "b.glb")
    assert sizes[1] < 0.7 * sizes[0]
    assert error_mm(world(found), animation) <= small.morph_error_mm + 1e-3
    assert small.morph_error_mm < plain.morph_error_mm + 0.02


def arkit_face() -> tuple[Animation, BlendShapes, np.ndarray]:
    """A face moved by ARKit's shapes of the ICT model, and what it was moved by."""
    model = assets.load_face_model()
    vertices, faces = assets.mean_face("narrow")
    names = ["jawOpen", "mouthSmile_L", "mouthSmile_R", "mouthPucker"]
    weights = 0.3 - 0.3 * np.cos(np.linspace(0, 6, 50)[:, None] * np.array([1, 0.7, 0.7, 1.9]))
    chosen = model.expression_basis[[model.index(name) for name in names]]
    motion = np.tensordot(weights, chosen[:, : len(vertices)], 1).astype(np.float32)
    landmarks = np.tensordot(weights, chosen[:, model.landmarks68], 1).astype(np.float32)
    animation = Animation(
        freetalk.Mesh(vertices, faces),
        motion,
        fps=30,
        landmarks=torch.from_numpy(landmarks),
    )
    targets = torch.from_numpy(chosen[:, : len(vertices)].astype(np.float32).copy())
    return animation, BlendShapes(names, targets, torch.from_numpy(weights).float()), weights


def test_given_shapes_come_first_and_the_rest_is_small(tmp_path: Path) -> None:
    pygltflib = pytest.importorskip("pygltflib")
    animation, shapes, _ = arkit_face()
    report = animation.save(tmp_path / "a.glb", rig=shapes)
    names = pygltflib.GLTF2().load(str(tmp_path / "a.glb")).meshes[0].extras["targetNames"]
    assert names[:4] == shapes.names
    assert report.num_morph_targets == 4  # they explain all of it
    with pytest.raises(ValueError, match="blend_shapes"):
        animation.save(tmp_path / "b.glb", rig="arkit")


def test_curves_follow_the_shapes_that_moved_the_face(tmp_path: Path) -> None:
    animation, _, weights = arkit_face()
    for name in ("a.csv", "a.json", "a.arkit.npz"):
        animation.save(tmp_path / name)
        curves, fps = load_curves(tmp_path / name)
        assert fps == pytest.approx(30)
        assert set(RigPoses.load(POSES).names) <= {*curves, "tongueOut"}
        assert np.corrcoef(curves["jawOpen"], weights[:, 0])[0, 1] > 0.95
    with pytest.raises(ValueError, match="no ARKit weights"):
        load_curves(tmp_path / "a.txt")


def test_csv_is_as_live_link_face_writes_it(tmp_path: Path) -> None:
    half = np.full(45, 0.5, np.float32)
    save_curves({"jawOpen": half, "tongueOut": half}, tmp_path / "a.CSV", fps=29.97)
    rows = list(csv.reader((tmp_path / "a.CSV").open()))
    header = (
        "Timecode,BlendShapeCount,EyeBlinkLeft,EyeLookDownLeft,EyeLookInLeft,EyeLookOutLeft,EyeLookUpLeft,"
        "EyeSquintLeft,EyeWideLeft,EyeBlinkRight,EyeLookDownRight,EyeLookInRight,EyeLookOutRight,EyeLookUpRight,"
        "EyeSquintRight,EyeWideRight,JawForward,JawRight,JawLeft,JawOpen,MouthClose,MouthFunnel,MouthPucker,"
        "MouthRight,MouthLeft,MouthSmileLeft,MouthSmileRight,MouthFrownLeft,MouthFrownRight,MouthDimpleLeft,"
        "MouthDimpleRight,MouthStretchLeft,MouthStretchRight,MouthRollLower,MouthRollUpper,MouthShrugLower,"
        "MouthShrugUpper,MouthPressLeft,MouthPressRight,MouthLowerDownLeft,MouthLowerDownRight,MouthUpperUpLeft,"
        "MouthUpperUpRight,BrowDownLeft,BrowDownRight,BrowInnerUp,BrowOuterUpLeft,BrowOuterUpRight,CheekPuff,"
        "CheekSquintLeft,CheekSquintRight,NoseSneerLeft,NoseSneerRight,TongueOut,HeadYaw,HeadPitch,HeadRoll,"
        "LeftEyeYaw,LeftEyePitch,LeftEyeRoll,RightEyeYaw,RightEyePitch,RightEyeRoll"
    )
    assert ",".join(rows[0]) == header  # of a take of the app
    assert rows[1][:2] == ["00:00:00:00.000", "61"]
    assert rows[31][0] == "00:00:01:00.030"
    assert len(rows) == 46 and all(len(row) == 63 for row in rows)
    assert rows[5][2 + CSV_NAMES.index("JawOpen")] == "0.5000000000"
    assert rows[5][2 + CSV_NAMES.index("JawLeft")] == "0.0000000000"


@pytest.mark.parametrize(("fps", "frames"), [(30, 12), (60, 45), (25, 60), (30, 200)])
def test_a_csv_tells_its_rate(tmp_path: Path, fps: float, frames: int) -> None:
    save_curves({"jawOpen": np.linspace(0, 1, frames)}, tmp_path / "a.csv", fps=fps)
    assert load_curves(tmp_path / "a.csv")[1] == pytest.approx(fps)


def test_a_short_csv_may_be_told_its_rate(tmp_path: Path) -> None:
    save_curves({"jawOpen": np.linspace(0, 1, 10)}, tmp_path / "a.csv", fps=25)
    assert load_curves(tmp_path / "a.csv", fps=25)[1] == 25


def test_json_is_as_audio2face_writes_it(tmp_path: Path) -> None:
    save_curves({"jawOpen": np.linspace(0, 1, 5)}, tmp_path / "a.json", fps=60)
    content = json.loads((tmp_path / "a.json").read_text())
    assert content["numFrames"] == 5 and content["exportFps"] == 60
    assert content["facsNames"] == ["jawOpen"] and np.shape(content["weightMat"]) == (5, 1)


def test_convert_reads_and_writes_every_kind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    animation = face_animation(6)
    animation.save(tmp_path / "a.npz")
    to = [str(tmp_path / name) for name in ("a.glb", "a.pc2", "frames/*.ply", "a.usda")]
    assert main(["convert", str(tmp_path / "a.npz"), *to]) == 0, capsys.readouterr().err
    assert "targets, within" in capsys.readouterr().out
    assert main(["convert", to[0], str(tmp_path / "b.npz"), "--quiet"]) == 0
    assert error_mm(world(Animation.load(tmp_path / "b.npz")), animation) <= 0.11
    assert main(["convert", to[1], str(tmp_path / "c.npz")]) == 2
    assert "mesh=" in capsys.readouterr().err
    cached = Animation.load(to[1], mesh=animation.mesh, fps=25)
    assert torch.allclose(cached.displacements, animation.displacements, atol=1e-5)
    assert main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "d.npz"), "--fps", "60"]) == 2
    assert "its own frame rate" in capsys.readouterr().err
    frames = Animation.load(tmp_path / "frames", fps=25)
    np.testing.assert_allclose(frames.vertices_at(5), animation.vertices_at(5), atol=1e-5)


def test_the_script_for_blender_needs_a_file_that_blender_opens() -> None:
    lines = blender_script("talk.glb", 29.97, 300).splitlines()
    assert len(lines) == 2 and "import_scene.gltf" in lines[0] and "talk.speech.wav" in lines[1]
    for line in lines:
        compile(line, "blender", "exec")
    with pytest.raises(ValueError, match="glb"):
        blender_script("talk.npz", 30, 10)


@pytest.mark.skipif(not BLENDER, reason="FREETALK_BLENDER_PYTHON names no Python with bpy")
@pytest.mark.parametrize("head", [False, True])
@pytest.mark.parametrize("name", ["a.glb", "c.glb", "a.usdc", "p.usdc"])
def test_blender_shows_what_was_written(tmp_path: Path, name: str, head: bool) -> None:
    animation = textured_animation(tmp_path)
    if head:
        animation = with_head(animation)
    options = {"c": {"compact": True}, "p": {"cache": True}}.get(name[0], {})
    report = animation.save(tmp_path / name, **options)
    script = tmp_path / "open.py"
    script.write_text(blender_script(tmp_path / name, animation.fps, animation.num_frames))
    tool = Path(__file__).with_name("blender_vertices.py")
    command = [BLENDER, str(tool), str(script), "25", str(tmp_path / "seen.npz")]
    subprocess.run(command, check=True, capture_output=True)
    seen = np.load(tmp_path / "seen.npz")
    expected = world(animation)
    if seen["vertices"].shape[1] == expected.shape[1]:
        error = np.linalg.norm(seen["vertices"] - expected, axis=-1).max() * MM
    else:  # a vertex for each material: by the nearest at rest, then on
        from scipy.spatial import cKDTree

        _, near = cKDTree(expected[0]).query(seen["vertices"][0])
        error = np.linalg.norm(seen["vertices"] - expected[:, near], axis=-1).max() * MM
    print(f"Blender, {name}: {error:.5f} mm, stated {report.morph_error_mm:.5f}")
    assert error <= 0.01 + report.morph_error_mm
    assert seen["fps"] == pytest.approx(25) and seen["end"] == 24
    assert seen["sound_frames"].tolist() == [25]
    assert seen["uv"] > 0
    assert any("part0" in name for name in seen["materials"])
