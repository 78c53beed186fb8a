"""A face that is told, or found on a body, speaks where it is; the rest of the mesh stays still."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from test_talker import write_weights

import freetalk
from freetalk.corpus.assets import load_face_model, mean_face, speech_clip
from freetalk.geometry import Similarity
from freetalk.talker.placement import REACH_M


@pytest.fixture(scope="module")
def talker(tmp_path_factory: pytest.TempPathFactory) -> freetalk.Talker:
    weights = write_weights(tmp_path_factory.mktemp("weights"))
    return freetalk.Talker.from_pretrained(weights, device="cpu")


@pytest.fixture(scope="module")
def speech() -> freetalk.Audio:
    clip = freetalk.load_audio(speech_clip())
    return freetalk.Audio(np.array(clip.samples[:6400]), 16000)


def askew() -> Similarity:
    """From metres to a mesh that lies askew, in a unit of its own."""
    a, b = np.deg2rad(50.0), np.deg2rad(-35.0)
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    z = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    return Similarity(7.0, x @ z, translation=np.array([3.0, -2.0, 9.0]))


def on_a_stick() -> tuple[np.ndarray, np.ndarray]:
    """The mean face, m, and a rod of a metre below it."""
    vertices, faces = mean_face("narrow")
    height = np.linspace(-0.2, -1.2, 40)
    ring = np.array([[0.02, 0, 0], [-0.01, 0, 0.017], [-0.01, 0, -0.017]])
    rod = (ring[None] + height[:, None, None] * np.array([0, 1, 0])).reshape(-1, 3)
    quads = [
        (3 * i + j, 3 * i + (j + 1) % 3, 3 * i + 3 + (j + 1) % 3)
        for i in range(39)
        for j in range(3)
    ]
    return np.concatenate([vertices, rod]), np.concatenate([faces, np.array(quads) + len(vertices)])


@pytest.mark.slow
def test_a_face_that_is_told_speaks_in_the_meshs_own_pose(
    talker: freetalk.Talker, speech: freetalk.Audio
) -> None:
    options = {"fps": 10, "tolerance_mm": 0, "cache_dir": None, "progress": False}
    marks = load_face_model().landmarks68
    vertices, faces = mean_face("narrow")
    plain = talker.animate(speech, freetalk.Mesh(vertices, faces.tolist()), **options)
    whole, triangles = on_a_stick()
    pose = askew()
    mesh = freetalk.Mesh(pose.apply(whole), triangles.tolist())
    told = talker.animate(speech, mesh, landmarks=marks, **options)
    assert told.displacements.shape == (plain.num_frames, len(whole), 3)
    assert not told.displacements[:, len(vertices) :].any()
    motion = told.displacements[:, : len(vertices)].numpy().astype(np.float64)
    back = np.stack([pose.inverse().apply_vectors(frame) for frame in motion])
    landmarks = vertices[marks]
    distance = np.linalg.norm(vertices[:, None] - landmarks[None], axis=2).min(axis=1)
    near = distance < REACH_M[0]
    difference = np.abs(back - plain.displacements.numpy())[:, near]
    assert difference.max() < 0.02 * float(plain.displacements.abs().max())
    found = talker.report
    assert found is not None
    assert "landmarks as given" in found.alignment.summary
    assert not found.alignment.guessed
    canonical = told.metadata["alignment"]["to_canonical"]
    assert canonical["scale"] == pytest.approx(1 / 7.0, rel=1e-6)
    np.testing.assert_allclose(np.asarray(told.frame.to_y_up), canonical["rotation"], atol=1e-12)


def test_a_told_face_fills_what_the_caller_gives_and_streams(
    talker: freetalk.Talker, speech: freetalk.Audio
) -> None:
    whole, triangles = on_a_stick()
    mesh = freetalk.Mesh(100 * whole, triangles.tolist())
    points = 100 * mean_face("narrow")[0][load_face_model().landmarks68]
    face = talker.prepare(mesh, landmarks=points, cache_dir=None, progress=False)
    out = torch.full((face.num_frames(speech, 10), len(whole), 3), torch.nan)
    animation = face.animate(speech, fps=10, out=out, progress=False)
    assert animation.displacements.data_ptr() == out.data_ptr()
    assert torch.isfinite(out).all()
    assert animation.frame.metres_per_unit == 0.01
    assert "+Y up, +Z forward" in face.report.alignment.summary
    with pytest.raises(ValueError, match="out must be"):
        face.animate(speech, fps=10, out=out[1:], progress=False)
    live = face.live(head_motion=True, seed=3)
    frames = live.push(np.array(speech.samples)) + live.finish()
    moved = live.decode(frames[-1]).numpy()
    np.testing.assert_allclose(moved[-1], 100 * whole[-1], rtol=1e-6)
    turned = face.animate(speech, head_motion=True, seed=3, progress=False).head
    torch.testing.assert_close(live.head(frames[-1]), turned[-1])
    assert abs(turned[-1][:3, 3]).max() > 10 * abs(frames[-1].head[:3, 3]).max()  # cm, far away


@pytest.mark.parametrize(
    ("landmarks", "message"),
    [
        (np.arange(67), "68 vertices or points"),
        (np.full(68, 10**6), "has 6826"),
        (np.full((68, 3), np.nan), "68 vertices or points"),
    ],
)
def test_landmarks_that_are_none_are_an_error(
    talker: freetalk.Talker, landmarks: np.ndarray, message: str
) -> None:
    whole, triangles = on_a_stick()
    with pytest.raises(ValueError, match=message):
        talker.prepare(
            freetalk.Mesh(whole, triangles.tolist()), landmarks=landmarks, progress=False
        )


@pytest.mark.slow
def test_what_is_no_face_is_refused_unless_told(
    talker: freetalk.Talker, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pyvista

    monkeypatch.setattr("freetalk.faces.available", lambda: False)
    knot = pyvista.ParametricTorus(ringradius=0.3, crosssectionradius=0.1).triangulate().clean()
    mesh = freetalk.Mesh(
        np.asarray(knot.points, np.float64), knot.regular_faces.tolist(), name="ring"
    )
    with pytest.raises(ValueError, match=r"ring does not look like a face.*freetalk\[faces\]"):
        talker.prepare(mesh, cache_dir=None, progress=False)
    told = talker.prepare(mesh, unit="m", up="+y", forward="+z", cache_dir=None, progress=False)
    assert "does not look like a face" in told.report.notices[0]
    assert told.report.notices[0].endswith("check the unit, up and forward that were given")
