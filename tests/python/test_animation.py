"""Animations: files that other programs read, and parts of a real head that follow the face."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import torch
from scipy.spatial.transform import Rotation

import freetalk
from freetalk.animation import Animation, PartMotion, Parts, morph_basis, resample_motion
from freetalk.corpus import assets
from freetalk.corpus.curves import facegood_weights
from freetalk.corpus.lips import Lips

MOUTH_INTERIOR = slice(14062, 21451)
UPPER_TEETH = slice(17039, 19247)
LOWER_TEETH = slice(19247, 21451)
EYEBALLS = slice(21451, 24591)
LASHES = slice(25351, 26719)


def face_animation(frames: int = 40) -> Animation:
    """The narrow mean face in centimetres, driven by a few expressions."""
    model = assets.load_face_model()
    vertices, faces = assets.mean_face("narrow")
    time = np.linspace(0, 6, frames)
    weights = np.zeros((frames, len(model.expression_names)), np.float32)
    for phase, name in enumerate(("jawOpen", "mouthSmile_L", "eyeBlink_L", "browInnerUp_R")):
        weights[:, model.index(name)] = 0.3 - 0.3 * np.cos(time * (1 + phase))
    basis = model.expression_basis[:, : len(vertices)]
    motion = np.tensordot(weights, basis, 1)
    audio = freetalk.Audio(np.sin(np.arange(16000, dtype=np.float32)), 16000)
    return Animation(
        freetalk.Mesh(vertices * 100, faces, name="face"),
        motion * 100,
        fps=25,
        audio=audio,
        metadata={"emotion": "fröhlich"},
        metres_per_unit=0.01,
    )


def test_npz_is_read_by_numpy(tmp_path: Path) -> None:
    animation = face_animation()
    animation.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as data:
        assert data["vertices"].shape == (6706, 3)
        assert data["faces"].dtype == np.int32
        assert data["displacements"].dtype == np.float32
        np.testing.assert_array_equal(data["displacements"], animation.displacements.numpy())
        np.testing.assert_array_equal(data["faces"], animation.faces)
        assert float(data["fps"]) == 25.0
        assert int(data["sample_rate_hz"]) == 16000
        assert len(data["audio"]) == 16000
        assert json.loads(str(data["metadata"])) == {"emotion": "fröhlich"}


def test_npz_that_numpy_wrote_is_read(tmp_path: Path) -> None:
    motion = np.zeros((2, 3, 3), np.float32)
    np.savez(
        tmp_path / "b.npz",
        vertices=np.eye(3, dtype=np.float32),
        faces=np.array([[0, 1, 2]]),
        displacements=motion,
        fps=30,
    )
    assert Animation.load(tmp_path / "b.npz").num_frames == 2
    np.savez_compressed(tmp_path / "c.npz", vertices=np.eye(3))
    with pytest.raises(RuntimeError, match="savez"):
        Animation.load(tmp_path / "c.npz")


def test_load_and_pickle_give_the_same_animation(tmp_path: Path) -> None:
    animation = face_animation(5)
    animation.save(tmp_path / "a.npz")
    loaded = Animation.load(tmp_path / "a.npz")
    assert torch.equal(loaded.displacements, animation.displacements)
    assert loaded.metadata == animation.metadata
    assert loaded.frame.metres_per_unit == 0.01
    assert np.allclose(loaded.vertices_at(3), animation.vertices_at(3))


def gltf_array(document: pygltflib.GLTF2, blob: bytes, index: int) -> np.ndarray:
    """The values of an accessor."""
    accessor = document.accessors[index]
    view = document.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
    dtype = np.float32 if accessor.componentType == pygltflib.FLOAT else np.uint32
    values = np.frombuffer(blob, dtype, accessor.count * width, view.byteOffset)
    return values.reshape(-1, width)


@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_gltf_morphs_rebuild_the_motion(tmp_path: Path, name: str) -> None:
    animation = face_animation()
    report = animation.save(tmp_path / name)
    document = pygltflib.GLTF2().load(str(tmp_path / name))
    assert document is not None
    blob = document.binary_blob() if name.endswith("glb") else (tmp_path / "a.bin").read_bytes()
    primitive = document.meshes[0].primitives[0]
    rest = gltf_array(document, blob, primitive.attributes.POSITION)
    np.testing.assert_allclose(rest, animation.vertices, atol=1e-5)
    triangles = gltf_array(document, blob, primitive.indices).reshape(-1, 3)
    np.testing.assert_array_equal(triangles, animation.faces)
    sampler = document.animations[0].samplers[0]
    times = gltf_array(document, blob, sampler.input)[:, 0]
    np.testing.assert_allclose(times, np.arange(40) / 25, atol=1e-6)
    targets = np.stack([gltf_array(document, blob, t["POSITION"]) for t in primitive.targets])
    weights = gltf_array(document, blob, sampler.output).reshape(40, len(targets))
    rebuilt = np.tensordot(weights, targets, 1)
    errors = np.linalg.norm(rebuilt - animation.displacements.numpy(), axis=-1)
    assert len(targets) == report.num_morph_targets <= 7  # four expressions
    assert weights.min() >= 0 and weights.max() <= 1  # Blender clamps to this
    assert errors.max() * 10 <= 0.1  # mm
    node = document.nodes[0]
    assert node.scale == [0.01] * 3


def nodding(frames: int) -> Animation:
    """A face whose head nods and leans forward, in centimetres, +Z up."""
    still = face_animation(frames)
    angle = np.linspace(0, 0.2, frames)
    head = np.tile(np.eye(4), (frames, 1, 1))
    head[:, 0, 0] = head[:, 1, 1] = np.cos(angle)
    head[:, 1, 0] = np.sin(angle)
    head[:, 0, 1] = -head[:, 1, 0]
    head[:, :3, 3] = np.outer(angle, [3.0, -2.0, 1.0])
    to_y_up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    options = {"fps": 25, "metres_per_unit": 0.01, "to_y_up": to_y_up, "head": head}
    return Animation(still.mesh, still.displacements, **options)


def test_a_moving_head_is_kept_and_moves_the_vertices(tmp_path: Path) -> None:
    animation = nodding(5)
    assert animation.head is not None
    points = animation.vertices + animation.displacements[4].numpy().astype(np.float64)
    pose = animation.head[4].numpy()
    expected = points @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(animation.vertices_at(4), expected, atol=1e-9)
    animation.save(tmp_path / "a.npz")
    for same in (Animation.load(tmp_path / "a.npz"), pickle.loads(pickle.dumps(animation))):
        assert same.head is not None and torch.equal(same.head, animation.head)
    animation.save(tmp_path / "frames" / "*.obj")  # a mesh has no transform: its vertices move
    mesh = freetalk.load_mesh(tmp_path / "frames" / "frame_00004.obj")
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-4)
    with pytest.raises(ValueError, match="head must be"):
        Animation(animation.mesh, animation.displacements, head=animation.head[1:])


@pytest.mark.parametrize("talks", [True, False])
def test_a_moving_head_is_a_node_of_gltf(tmp_path: Path, talks: bool) -> None:
    animation = nodding(8)
    if not talks:
        animation = Animation(
            *(animation.mesh, 0 * animation.displacements),
            fps=25,
            metres_per_unit=0.01,
            to_y_up=animation.frame.to_y_up,
            head=animation.head,
        )
    animation.save(tmp_path / "a.glb")
    document = pygltflib.GLTF2().load(str(tmp_path / "a.glb"))
    assert document is not None and document.scenes[0].nodes == [1]
    head, face = document.nodes[1], document.nodes[0]
    assert (head.name, head.children) == ("head", [0])
    motion, blob = document.animations[0], document.binary_blob()
    paths = ["weights"] * talks + ["rotation", "translation"]
    assert [channel.target.path for channel in motion.channels] == paths
    assert [channel.target.node for channel in motion.channels] == [0] * talks + [1, 1]
    turns, shifts = (gltf_array(document, blob, s.output) for s in motion.samplers[-2:])
    inner = 0.01 * Rotation.from_quat(face.rotation).as_matrix()
    for t in (0, 3, 7):
        world = Rotation.from_quat(turns[t]).as_matrix() @ inner @ animation.vertices.T
        assert animation.head is not None
        turn = animation.head[t, :3, :3].numpy()
        posed = animation.vertices_at(t) - animation.displacements[t].numpy() @ turn.T
        np.testing.assert_allclose(world.T + shifts[t], posed @ inner.T, atol=1e-6)


def test_glb_is_read_by_trimesh(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    animation = face_animation(3)
    animation.save(tmp_path / "a.glb")
    scene = trimesh.load(tmp_path / "a.glb", process=False)
    (geometry,) = scene.geometry.values()
    assert len(geometry.faces) == len(animation.faces)
    extent = np.ptp(animation.vertices, axis=0) * 0.01
    np.testing.assert_allclose(scene.extents, extent, rtol=1e-4)  # metres


def test_unknown_extension_and_unwritable_folder(tmp_path: Path) -> None:
    animation = face_animation(2)
    with pytest.raises(ValueError, match=r"\.glb"):
        animation.save(tmp_path / "a.fbx")
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError):
        animation.save(tmp_path / "file" / "a.npz")
    with pytest.raises(RuntimeError):
        animation.save(tmp_path / "file" / "*.obj")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_displacements_must_fit_the_mesh() -> None:
    vertices, faces = assets.mean_face("narrow")
    with pytest.raises(ValueError, match="6706"):
        Animation(freetalk.Mesh(vertices, faces), np.zeros((2, 5, 3), np.float32))


def test_animation_pickles() -> None:
    mesh = freetalk.Mesh(np.eye(3), [[0, 1, 2]])
    animation = Animation(mesh, torch.zeros(2, 3, 3), fps=12, metadata={"a": 1})
    again = pickle.loads(pickle.dumps(animation))
    assert again.fps == 12
    np.testing.assert_array_equal(again.faces, mesh.faces)
    assert again.metadata == {"a": 1}


def test_morph_basis_and_resampling() -> None:
    motion = face_animation(30).displacements
    targets, weights, error = morph_basis(motion, 1e-3)
    rebuilt = torch.einsum("tk,kvc->tvc", weights, targets)
    assert float((rebuilt - motion).norm(dim=-1).max()) == pytest.approx(error, abs=1e-5)
    assert torch.equal(resample_motion(motion, 30, 30, 30), motion)


@pytest.fixture(scope="module")
def head() -> tuple[assets.FaceModel, Parts]:
    model = assets.load_face_model()
    vertices, faces = assets.mean_face("full")
    return model, Parts(
        vertices.astype(np.float64), faces, model.neutral[model.landmarks68].astype(np.float64)
    )


def test_parts_of_the_full_head_are_recognised(head: tuple[assets.FaceModel, Parts]) -> None:
    model, parts = head
    motions = np.array([part.motion for part in parts.parts])[np.array(parts.part_of_vertex)]
    assert (motions[:14062] == PartMotion.FACE).all()
    assert (motions[UPPER_TEETH] == PartMotion.STILL).all()
    assert (motions[LOWER_TEETH] == PartMotion.JAW).all()
    assert (motions[EYEBALLS] == PartMotion.STILL).all()
    assert (motions[LASHES] == PartMotion.SURFACE).all()
    # Gums and tongue are one piece: right for nearly all vertices of either jaw.
    truth = np.linalg.norm(model.expression_basis[model.index("jawOpen")], axis=-1) > 2e-3
    share = np.array(parts.jaw_share)[14062:17039]
    assert np.abs(share - truth[14062:17039]).mean() < 0.05


def drive(head: tuple[assets.FaceModel, Parts], weights: np.ndarray) -> tuple[np.ndarray, ...]:
    """Moves the parts by true skin and landmark motion; the result and the truth, metres."""
    model, parts = head
    truth = np.tensordot(weights.astype(np.float32), model.expression_basis, 1)
    skin = torch.from_numpy(truth[:, :14062].copy())
    moved = parts.move(skin, torch.from_numpy(truth[:, model.landmarks68].copy()))
    return moved.numpy(), truth


@pytest.mark.parametrize(
    ("name", "limit_mm"), [("jawOpen", 0.5), ("jawLeft", 1.5), ("jawForward", 1.5)]
)
@pytest.mark.parametrize("amount", [0.25, 0.6])
def test_lower_teeth_follow_the_jaw(
    head: tuple[assets.FaceModel, Parts], name: str, limit_mm: float, amount: float
) -> None:
    model, _ = head
    weights = np.zeros((1, len(model.expression_names)))
    weights[0, model.index(name)] = amount
    moved, truth = drive(head, weights)
    errors = np.linalg.norm(moved - truth, axis=-1)[0]
    motion = np.linalg.norm(truth[0, LOWER_TEETH], axis=-1).mean()
    error = errors[LOWER_TEETH].mean()
    print(f"{name} {amount}: lower teeth move {motion * 1e3:.2f} mm, error {error * 1e3:.2f} mm")
    # Blend shapes move on a line, bones on an arc: that much may differ when half open.
    assert error < max(limit_mm * 1e-3, 0.12 * motion)
    assert errors[UPPER_TEETH].max() < 1e-6
    assert errors[EYEBALLS].max() < 1e-6


def test_teeth_follow_captured_speech(head: tuple[assets.FaceModel, Parts]) -> None:
    model, _ = head
    take = assets.load_take("1114_3_15")
    weights = facegood_weights(model, Lips(model), take)[200:1400:12]
    moved, truth = drive(head, weights)
    errors = np.linalg.norm(moved - truth, axis=-1)
    motion = np.linalg.norm(truth[:, LOWER_TEETH], axis=-1)
    error = errors[:, LOWER_TEETH]
    print(f"speech: teeth move {motion.mean() * 1e3:.2f} mm, error {error.mean() * 1e3:.2f} mm")
    assert error.mean() < 0.5 * motion.mean()
    assert error.mean() < 2e-3


def test_lashes_follow_the_lids(head: tuple[assets.FaceModel, Parts]) -> None:
    model, _ = head
    weights = np.zeros((1, len(model.expression_names)))
    weights[0, model.index("eyeBlink_L")] = 1
    weights[0, model.index("eyeBlink_R")] = 1
    moved, truth = drive(head, weights)
    motion = np.linalg.norm(truth[0, LASHES], axis=-1).mean()
    error = np.linalg.norm(moved[0, LASHES] - truth[0, LASHES], axis=-1).mean()
    print(f"blink: lashes move {motion * 1e3:.2f} mm, error {error * 1e3:.2f} mm")
    assert error < 0.6 * motion  # lashes also turn with the lid, which following does not


def test_any_identity_is_told_apart(head: tuple[assets.FaceModel, Parts]) -> None:
    model, _ = head
    _, faces = assets.mean_face("full")
    rng = np.random.default_rng(4)
    landmarks = model.neutral[model.landmarks68].astype(np.float64)
    for scale in (0.93, 1.0, 1.07):
        vertices = model.neutral.astype(np.float64) * scale
        shift = rng.normal(0, 1.5e-3, 3)
        parts = Parts(vertices + shift, faces, landmarks)
        motions = np.array([part.motion for part in parts.parts])[np.array(parts.part_of_vertex)]
        assert (motions[UPPER_TEETH] == PartMotion.STILL).all()
        assert (motions[LOWER_TEETH] == PartMotion.JAW).all()
        assert (motions[EYEBALLS] == PartMotion.STILL).all()
