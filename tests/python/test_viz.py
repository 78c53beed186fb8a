"""Pictures and videos of animations."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import freetalk
from freetalk import viz
from freetalk.corpus.assets import load_face_model, mean_face, speech_clip
from freetalk.viz.appearance import IVORY, PUPIL, SKIN, NormalField, part_labels, vertex_colors
from freetalk.viz.cavities import boundary_rims, find_cavities

SIZE = (96, 96)
RATE_HZ = 16000


def talking_face(num_frames: int = 12, fps: float = 25.0) -> viz.Sequence:
    """The mean face opening its jaw, with a tone of the same length."""
    vertices, faces = mean_face("face")
    model = load_face_model()
    jaw = model.expression_basis[model.index("jawOpen"), : len(vertices)]
    opening = 0.5 - 0.5 * np.cos(np.linspace(0, 2 * np.pi, num_frames))
    time = np.arange(round(num_frames / fps * RATE_HZ)) / RATE_HZ
    return viz.Sequence(
        vertices=vertices,
        faces=faces.astype(np.int64),
        displacements=(opening[:, None, None] * 0.6 * jaw).astype(np.float32),
        fps=fps,
        samples=(0.3 * np.sin(2 * np.pi * 220 * time)).astype(np.float32),
        sample_rate_hz=RATE_HZ,
        located=True,
    )


@pytest.fixture(scope="module")
def face() -> viz.Sequence:
    return talking_face()


def probe(path: Path) -> dict[str, dict[str, str]]:
    """ffprobe's view of the streams of a file, by kind."""
    command = ["ffprobe", "-v", "error", "-show_streams", "-of", "json", str(path)]
    text = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    return {stream["codec_type"]: stream for stream in json.loads(text)["streams"]}


# ---- geometry of pictures ------------------------------------------------------------------------


def test_normals_of_a_sphere_point_outwards() -> None:
    pyvista = pytest.importorskip("pyvista")
    ball = pyvista.Sphere(theta_resolution=60, phi_resolution=60)
    points = np.asarray(ball.points, dtype=np.float32)
    normals = NormalField(ball.regular_faces.astype(np.int64), len(points))(points)
    outwards = points / np.linalg.norm(points, axis=1, keepdims=True)
    # Vertices of a 60 x 60 sphere are tilted by less than the half angle of a triangle, 3 degrees.
    assert np.einsum("ij,ij->i", normals, outwards).min() > np.cos(np.deg2rad(3))


def test_vertex_without_triangle_has_a_unit_normal() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]], dtype=np.float32)
    normals = NormalField(np.array([[0, 1, 2]]), 4)(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-6)


def test_parts_are_numbered_by_size() -> None:
    faces = np.array([[5, 6, 7], [0, 1, 2], [2, 1, 3]])
    np.testing.assert_array_equal(
        part_labels(faces, 8)[[0, 1, 2, 3, 5, 6, 7]], [0, 0, 0, 0, 1, 1, 1]
    )


def test_rims_of_the_face_are_border_eyes_and_mouth() -> None:
    vertices, faces = mean_face("face")
    rims = boundary_rims(faces.astype(np.int64), len(vertices))
    assert len(rims) == 4
    found = find_cavities(vertices, faces.astype(np.int64))
    assert len(found.eyes) == 2 and found.mouth is not None
    left, right = sorted(found.eyes, key=lambda eye: -eye.center[0])
    np.testing.assert_allclose(left.center * [-1, 1, 1], right.center, atol=1e-3)
    assert 0.009 < left.radius < 0.016  # a human eyeball's radius is about 12 mm


def test_closed_lids_hide_the_eyes() -> None:
    vertices, faces = mean_face("face")
    clip = freetalk.load_audio(speech_clip())
    audio = freetalk.Audio(np.array(clip.samples)[: 2 * RATE_HZ], RATE_HZ)
    face = freetalk.Talker.from_pretrained().prepare(
        freetalk.Mesh(vertices.astype(float), faces.tolist()), progress=False
    )
    spoken = face.animate(audio, progress=False)
    lids = np.asarray(spoken.landmarks)[:, 37, 1] - np.asarray(spoken.landmarks)[:, 41, 1]
    shown = [int(lids.argmax()), int(lids.argmin())]
    assert lids[shown[1]] < -0.006
    motion = np.asarray(spoken.displacements)[shown].astype(np.float32)
    sequence = viz.Sequence(vertices, faces.astype(np.int64), motion, 1.0, located=True)
    open_eyes, closed = (
        frame[100:220] for frame in viz.render_frames(sequence, (0, 1), (400, 400))
    )
    assert (open_eyes.max(axis=-1) < 12).sum() > 20  # pupils
    assert (closed.max(axis=-1) < 12).sum() == 0


def test_mesh_with_its_own_sockets_gets_no_eyes() -> None:
    vertices, faces = mean_face("sockets")
    found = find_cavities(vertices, faces.astype(np.int64))
    assert not found.eyes and found.mouth is None


def test_eyeballs_get_a_pupil_that_looks_forward() -> None:
    pyvista = pytest.importorskip("pyvista")
    skin = pyvista.Plane(i_resolution=40, j_resolution=40).triangulate()
    ball = pyvista.Sphere(
        radius=0.012, center=(0.03, 0.03, 0), theta_resolution=40, phi_resolution=40
    )
    points = np.vstack([skin.points, ball.points]).astype(np.float32)
    faces = np.vstack([skin.regular_faces, ball.regular_faces + skin.n_points]).astype(np.int64)
    colors = vertex_colors(points, faces).astype(float) / 255
    np.testing.assert_allclose(colors[0], SKIN, atol=0.01)
    eye = slice(skin.n_points, None)
    front = skin.n_points + int(np.argmax(points[eye, 2]))
    back = skin.n_points + int(np.argmin(points[eye, 2]))
    np.testing.assert_allclose(colors[front], PUPIL, atol=0.01)
    np.testing.assert_allclose(colors[back], IVORY, atol=0.01)


# ---- pictures ------------------------------------------------------------------------------------


def difference(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """Mean absolute difference of two images in grey levels."""
    return float(np.abs(first.astype(float) - second.astype(float)).mean())


def test_frame_shows_a_lit_face_before_a_background(face: viz.Sequence) -> None:
    image = viz.render_frame(face, 0.0, SIZE)
    assert image.shape == (96, 96, 3) and image.dtype == np.uint8
    center, corner = image[44:52, 44:52].mean((0, 1)), image[:4, :4].mean((0, 1))
    assert center[0] > center[2] + 20  # skin is warm
    assert corner[2] > corner[0]  # the background is cool


def test_motion_changes_the_picture_below_the_nose(face: viz.Sequence) -> None:
    closed, opened = viz.render_frames(face, [0.0, 0.5 * face.duration_s], SIZE)
    changed = np.abs(closed.astype(int) - opened).sum(2)
    assert changed.max() > 100
    # the jaw also drags the skin at the border of the head by fractions of a millimetre
    assert changed[48:].sum() > 0.9 * changed.sum()


@pytest.mark.parametrize("unit", [0.01, 1000.0])
def test_any_unit_and_pose_looks_the_same_upright(face: viz.Sequence, unit: float) -> None:
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # mesh axes to canonical
    offset = np.array([0.3, -0.2, 0.7])
    own = (face.vertices - offset) @ turn / unit
    motion = face.displacements @ turn.astype(np.float32) / np.float32(unit)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = unit * turn, offset
    moved = viz.Sequence(
        own.astype(np.float32), face.faces, motion, face.fps, upright_matrix=matrix, located=True
    )
    expected = viz.render_frame(face, 0.2, SIZE)
    # float32 positions move silhouettes by a fraction of a pixel
    assert difference(expected, viz.render_frame(moved, 0.2, SIZE)) < 0.5


def test_a_moving_head_is_seen_where_it_is() -> None:
    """A head that went aside gives the picture of a face whose vertices did."""
    still = talking_face(2)
    head = np.tile(np.eye(4), (2, 1, 1))
    head[1, 0, 3] = 0.02
    shift = head[:, None, :3, 3].astype(np.float32)
    times, plain = (0.0, 1 / still.fps), viz.View(fill_openings=False)
    before, after = viz.render_frames(replace(still, head=head), times, SIZE, plain)
    aside = replace(still, displacements=still.displacements + shift)
    assert difference(after, viz.render_frames(aside, times, SIZE, plain)[1]) < 0.5
    assert difference(after, before) > 3.0


def test_time_between_frames_is_interpolated(face: viz.Sequence) -> None:
    halfway = face.at_time(2.5 / face.fps)
    np.testing.assert_allclose(halfway, (face.frame(2) + face.frame(3)) / 2, atol=1e-6)
    np.testing.assert_array_equal(face.at_time(99.0), face.frame(face.num_frames - 1))


def test_contact_sheet_holds_rows_columns_and_waveform(face: viz.Sequence, tmp_path: Path) -> None:
    from PIL import Image

    path = viz.contact_sheet([face, face], ["a", "b"], tmp_path / "s.png", num_columns=3, cell=64)
    width, height = Image.open(path).size
    assert width > 3 * 64 and height > 2 * 64 + 20
    assert [entry.name for entry in tmp_path.iterdir()] == ["s.png"]


def test_contact_sheet_refuses_missing_labels(face: viz.Sequence, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="2 and 1"):
        viz.contact_sheet([face, face], ["a"], tmp_path / "s.png")


def test_landmark_plot_is_written(tmp_path: Path) -> None:
    model = load_face_model()
    landmarks = model.neutral[model.landmarks68][None].repeat(5, 0)
    path = viz.landmark_plot(landmarks, tmp_path / "landmarks.png")
    assert path.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match=r"\(T, 68, 3\)"):
        viz.landmark_plot(landmarks[:, :5], tmp_path / "other.png")


# ---- videos --------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [None, 29.97, 10.0])
def test_sound_and_pictures_are_equally_long(
    face: viz.Sequence, tmp_path: Path, fps: float | None
) -> None:
    path = viz.save_video(face, tmp_path / "talk.mp4", fps=fps, size=SIZE, progress=False)
    streams = probe(path)
    video, audio = streams["video"], streams["audio"]
    rate = Fraction(video["r_frame_rate"])
    assert (video["codec_name"], video["pix_fmt"], audio["codec_name"]) == (
        "h264",
        "yuv420p",
        "aac",
    )
    assert float(rate) == pytest.approx(fps or face.fps, rel=1e-4)
    assert int(video["nb_frames"]) == round(face.duration_s * rate)
    assert abs(float(video["duration"]) - float(audio["duration"])) <= 1 / rate
    assert abs(float(video["duration"]) - face.duration_s) <= 1 / rate
    assert [entry.name for entry in tmp_path.iterdir()] == ["talk.mp4"]


def test_webm_holds_the_same_length(face: viz.Sequence, tmp_path: Path) -> None:
    streams = probe(viz.save_video(face, tmp_path / "talk.webm", size=SIZE, progress=False))
    assert streams["video"]["codec_name"] == "vp9" and streams["audio"]["codec_name"] == "opus"
    with pytest.raises(ValueError, match=r"\.webm"):
        viz.save_video(face, tmp_path / "talk.avi", size=SIZE)


def test_silent_animation_has_no_sound_track(tmp_path: Path) -> None:
    silent = talking_face(num_frames=3)
    silent.samples = np.zeros(0, np.float32)
    assert set(probe(viz.save_video(silent, tmp_path / "s.mp4", size=SIZE))) == {"video"}


def test_very_fast_animation_is_shown_at_sixty(tmp_path: Path) -> None:
    fast = talking_face(num_frames=60, fps=300.0)
    stream = probe(viz.save_video(fast, tmp_path / "fast.mp4", size=SIZE))["video"]
    assert (stream["r_frame_rate"], stream["nb_frames"]) == ("60/1", "12")


def test_failed_video_leaves_nothing_and_keeps_the_old_one(tmp_path: Path) -> None:
    target = tmp_path / "talk.mp4"
    target.write_bytes(b"old")
    frame = np.zeros((96, 96, 3), np.uint8)

    def frames() -> object:
        yield frame
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        viz.write_video(target, frames(), SIZE, Fraction(25), 9, np.zeros(0, np.float32), RATE_HZ)  # type: ignore[arg-type]
    assert target.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["talk.mp4"]


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("talk.avi", {}, "must end in .mp4"),
        ("talk.mp4", {"size": (95, 96)}, "even"),
        ("talk.mp4", {"fps": 0.0}, "above 0"),
        ("talk.mp4", {"fps": float("nan")}, "above 0"),
    ],
)
def test_video_options_are_checked(
    face: viz.Sequence, tmp_path: Path, name: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        viz.save_video(face, tmp_path / name, **{"size": SIZE, **options})  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_missing_ffmpeg_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    import imageio_ffmpeg

    def missing() -> str:
        raise RuntimeError("No ffmpeg exe could be found.")

    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", missing)
    monkeypatch.setenv("PATH", "")  # nor the system's
    with pytest.raises(RuntimeError, match="no ffmpeg was found; pip install imageio-ffmpeg"):
        viz.check_video_support()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.zeros((4, 2), np.float32)}, "vertices must be"),
        ({"faces": np.zeros((0, 3), np.int64)}, "at least one face"),
        ({"displacements": np.zeros((2, 5, 3), np.float32)}, r"\(T, 3, 3\)"),
        ({"fps": 0.0}, "fps must be above 0"),
    ],
)
def test_sequence_is_checked(change: dict[str, object], message: str) -> None:
    good: dict[str, object] = {
        "vertices": np.zeros((3, 3), np.float32),
        "faces": np.array([[0, 1, 2]]),
        "displacements": np.zeros((2, 3, 3), np.float32),
        "fps": 30.0,
    }
    with pytest.raises(ValueError, match=message):
        viz.Sequence(**{**good, **change})  # type: ignore[arg-type]
