"""The page: what is packed into it, and that it holds all it needs."""

from __future__ import annotations

import re
import threading
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from page_takes import speaking

import freetalk as ft
from freetalk import page
from freetalk.cli import main
from freetalk.corpus.assets import mean_face
from freetalk.viz.appearance import part_labels, seen_faces


@pytest.fixture(scope="module")
def animation() -> ft.Animation:
    return speaking()


def quad(**options: object) -> ft.Animation:
    """Two triangles whose texture is torn along the diagonal."""
    mesh = ft.Mesh(
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]),
        [[0, 1, 2], [0, 2, 3]],
        texcoords=np.array([[0.0, 0], [0.4, 0], [0.4, 1], [0.6, 0], [1, 1], [0.6, 1]]),
        polygon_texcoords=[[0, 1, 2], [3, 4, 5]],
    )
    motion = np.zeros((3, 4, 3), np.float32)
    motion[1, 2] = (0.0, 0.0, 0.25)
    return ft.Animation(mesh, motion, **options)


@pytest.mark.parametrize("tolerance_mm", [0.5, 0.05])
def test_packed_motion_keeps_the_bound_it_states(
    animation: ft.Animation, tolerance_mm: float
) -> None:
    turn = 10.0 * np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # in decimetres, on its side
    motion = animation.displacements.numpy() / 10
    packed = page.pack_motion(motion, turn, tolerance_mm)
    off = np.linalg.norm(page.unpack_motion(packed) - motion @ turn.T, axis=2).max()
    assert packed.error_mm <= tolerance_mm
    assert packed.error_mm == pytest.approx(1e3 * off, rel=1e-3)


def test_a_finer_bound_costs_more(animation: ft.Animation) -> None:
    coarse, fine = (page.pack_take(animation, tolerance_mm=mm) for mm in (0.5, 0.02))
    raw = animation.displacements.numel() * 4
    assert len(coarse) < len(fine) < raw


def test_a_take_holds_surface_sound_and_shapes(animation: ft.Animation) -> None:
    sequence = ft.viz.as_sequence(animation)
    marks = page.find_landmarks(sequence)
    assert marks is not None
    curves = page.arkit_curves(sequence, marks)
    packed = page.pack_take(
        animation, name="one", landmarks=marks, curves=curves, phones=[(0.0, 0.2, "AA")]
    )
    header, arrays = page.read_take(packed)
    assert header["name"] == "one" and header["frames"] == 12
    np.testing.assert_allclose(arrays["rest"], animation.vertices, atol=1e-7)
    np.testing.assert_array_equal(arrays["faces"], animation.faces)
    np.testing.assert_allclose(arrays["sound"] / 32767, animation.audio.samples, atol=1e-4)
    assert arrays["curves"].shape == (51, 12) and arrays["landmarks"].shape == (68,)
    assert header["phones"] == [[0.0, 0.2, "AA"]]
    assert len(header["eyes"]) == 2 and len(arrays["mouth_edges"]) > 10


def test_a_take_holds_the_heads_motion_in_metres_and_upright() -> None:
    head = np.tile(np.eye(4), (3, 1, 1))
    head[1, :3, 3] = [0.0, 0.0, 10.0]  # up, in centimetres
    up = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    moving = quad(head=head, metres_per_unit=0.01, to_y_up=up)
    poses = page.read_take(page.pack_take(moving))[1]["head"]
    np.testing.assert_allclose(poses[0].T, np.eye(4), atol=1e-7)
    np.testing.assert_allclose(poses[1].T[:3, 3], [0, 0.1, 0], atol=1e-7)
    assert "head" not in page.read_take(page.pack_take(quad()))[1]


@pytest.mark.slow
def test_an_opening_jaw_is_seen_as_jaw_open(animation: ft.Animation) -> None:
    sequence = ft.viz.as_sequence(animation)
    marks = page.find_landmarks(sequence)
    assert marks is not None
    curves = page.arkit_curves(sequence, marks)
    assert max(curves, key=lambda name: curves[name].max()) == "jawOpen"
    assert curves["jawOpen"][6] == pytest.approx(0.6, abs=0.12)


def test_an_animation_without_alignment_has_no_landmarks() -> None:
    assert page.find_landmarks(ft.viz.as_sequence(quad())) is None


def test_sheets_and_lashes_before_eyeballs_are_not_drawn() -> None:
    vertices, faces = mean_face("full")
    seen = seen_faces(vertices, faces.astype(np.int64))
    labels = part_labels(faces, len(vertices))
    drawn, all_parts = set(labels[seen[:, 0]]), set(labels)
    hidden = [vertices[labels == part] for part in all_parts - drawn]
    assert len(hidden) == 18  # on either side three sheets and six strips of lashes
    for points in hidden:
        assert abs(points[:, 1].mean() - 0.037) < 0.01 and np.ptp(points[:, 1]) < 0.025
    assert {labels[0], labels[22221], labels[21451]} <= drawn  # skin and eyeballs


def test_a_face_without_eyeballs_is_drawn_whole() -> None:
    vertices, faces = mean_face("face")
    assert len(seen_faces(vertices, faces.astype(np.int64))) == len(faces)


def test_vertices_on_a_seam_are_drawn_once_for_each_texture_coordinate(tmp_path: Path) -> None:
    picture = tmp_path / "skin.png"
    picture.write_bytes(b"a picture")
    header, arrays = page.read_take(page.pack_take(quad(), texture=picture))
    assert header["texture"] == {"type": "image/png"}
    assert arrays["texture"].tobytes() == b"a picture"
    assert len(arrays["corners"]) == 6
    assert sorted(arrays["corners"]) == [0, 0, 1, 2, 2, 3]
    np.testing.assert_array_equal(arrays["corners"][arrays["faces"]], [[0, 1, 2], [0, 2, 3]])
    seen = arrays["texcoords"][arrays["faces"]]
    np.testing.assert_allclose(seen[1], [[0.6, 0], [1, 1], [0.6, 1]], atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tolerance_mm": 0}, "tolerance_mm"),
        ({"colors": np.zeros((3, 3))}, r"\(4, 3\)"),
        ({"curves": {"jawOpen": np.zeros(2)}}, r"\(3,\)"),
        ({"landmarks": np.array([4])}, "0 to 3"),
        ({"texture": "skin.tiff"}, "PNG"),
    ],
)
def test_what_does_not_fit_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        page.pack_take(quad(), **options)  # type: ignore[arg-type]


def test_a_texture_needs_coordinates(animation: ft.Animation, tmp_path: Path) -> None:
    (tmp_path / "skin.png").write_bytes(b"x")
    with pytest.raises(ValueError, match="texture coordinates"):
        page.pack_take(animation, texture=tmp_path / "skin.png")


def test_other_content_is_no_take() -> None:
    import gzip

    with pytest.raises(ValueError, match="not a take"):
        page.read_take(gzip.compress(b"something else"))


def test_the_page_names_no_other_host_and_may_connect_to_none(tmp_path: Path) -> None:
    file = tmp_path / "talk.html"
    assert quad().save(file, title="<b>A & B</b>").format == "html"
    text = file.read_text()
    assert "connect-src 'none'" in text and "default-src 'none'" in text
    addresses = set(re.findall(r"https?://[^\s'\"<>)]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}
    assert "<b>A" not in text and "&lt;b&gt;A &amp; B" in text
    assert "<!--" not in text
    assert [path.name for path in tmp_path.iterdir()] == ["talk.html"]


def test_a_page_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="needs an animation"):
        page.make_page({})


def test_view_writes_a_page_of_several_takes_and_their_truth(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        quad().save(tmp_path / folder / "talk.npz")
    quad().save(tmp_path / "gt.npz")
    out = tmp_path / "compare.html"
    files = [str(tmp_path / folder / "talk.npz") for folder in ("a", "b")]
    truth = ["--truth", str(tmp_path / "gt.npz")]
    assert main(["view", *files, *truth, "--html", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    text = out.read_text()
    assert text.count('class="take"') == 3 and '"truth": 2' in text
    assert "<title>compare</title>" in text


def test_the_server_answers_its_secret_address_alone() -> None:
    with page.PageServer("<p>hello") as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        assert server.address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(server.address) as answer:
            assert answer.read() == b"<p>hello" and answer.headers["Cache-Control"] == "no-store"
        for path in ("/", "/favicon.ico", "/../etc/passwd", server.path + "x"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(f"http://127.0.0.1:{server.port}{path}")
        server.shutdown()


def test_view_prints_the_address_where_there_is_no_display(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    quad().save(tmp_path / "talk.npz")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")

    def stop(_: page.PageServer) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(page.PageServer, "serve_forever", stop)
    assert main(["view", str(tmp_path / "talk.npz")]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"showing http://127\.0\.0\.1:\d+/\S{22}/ until Ctrl-C", printed)
    assert "ssh -L" in printed
