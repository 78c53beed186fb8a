"""The server: what it takes on, what it refuses, and that nothing brings it down."""

from __future__ import annotations

import io
import json
import shutil
import struct
import tempfile
import threading
import time
import wave
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_stm_ablations import SHIPPED
from test_talker import write_weights

import freetalk as ft
from freetalk.corpus.assets import load_face_model
from freetalk.corpus.topologies import crop, decimate
from freetalk.faces import MARKS
from freetalk.mesh import save_mesh
from freetalk.page import read_take
from freetalk.page.viewing import PAGE_HEADERS

pytest.importorskip("starlette", reason="pip install 'freetalk[serve]'")

from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from freetalk.serve import Limits, Refused, Studio, make_app
from freetalk.serve.jobs import GivenUp, Job, JobQueue, Report
from freetalk.serve.uploads import plain_name, read_mesh, read_sound

TOKEN = "a-secret-of-the-address"
LIMITS = Limits(
    upload_bytes=1 << 20, sound_s=3.0, vertices=5000, waiting=2, kept=4, live=1, patience_s=60
)


def small_face() -> ft.Mesh:
    """The mean face with about 900 vertices."""
    model = load_face_model()
    mesh = decimate(model, crop(model, "face"), 900)
    return ft.Mesh(mesh.carry @ model.neutral.astype(np.float64), mesh.faces.tolist(), name="small")


def wav(seconds: float = 0.4, rate_hz: int = 16000) -> bytes:
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    samples = (9000 * np.sin(900 * time_s) * (0.6 + 0.4 * np.sin(20 * time_s))).astype("<i2")
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(1)
        out.setsampwidth(2)
        out.setframerate(rate_hz)
        out.writeframes(samples.tobytes())
    return file.getvalue()


@pytest.fixture(scope="module")
def talker(tmp_path_factory: pytest.TempPathFactory) -> ft.Talker:
    weights = write_weights(tmp_path_factory.mktemp("weights"))
    shutil.copy(Path(SHIPPED).parent / "rig_poses.safetensors", weights)
    return ft.Talker.from_pretrained(weights)


@pytest.fixture(scope="module")
def client(talker: ft.Talker, tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FREETALK_CACHE", str(tmp_path_factory.mktemp("cache")))
        studio = Studio(talker, small_face(), LIMITS)
        with TestClient(make_app(studio, TOKEN), base_url=f"http://test/{TOKEN}/") as client:
            yield client


def state(client: TestClient) -> dict[str, Any]:
    answer: dict[str, Any] = client.get("state", params={"client": "me"}).json()
    return answer


def finished(client: TestClient, job_id: str) -> dict[str, Any]:
    """A job when it is over."""
    for _ in range(600):
        job = next(job for job in state(client)["jobs"] if job["id"] == job_id)
        if job["state"] not in ("waiting", "running"):
            return dict(job)
        time.sleep(0.1)
    raise AssertionError("the job does not end")


@pytest.fixture(scope="module")
def take(client: TestClient) -> str:
    """A take that was made through the server."""
    sound = client.post("sounds", params={"name": "a.wav"}, content=wav()).json()["id"]
    wish = {
        "mesh": state(client)["meshes"][0]["id"],
        "sound": sound,
        "emotion": "happy:0.5",
        "seed": 3,
    }
    answer = client.post("takes", params={"client": "me"}, json=wish)
    assert answer.status_code == 202
    job = finished(client, answer.json()["id"])
    assert job["state"] == "done", job["message"]
    return str(job["result"])


# ---- doors ---------------------------------------------------------------------------------------


def test_the_page_is_there_for_those_who_know_its_address(client: TestClient) -> None:
    answer = client.get("")
    assert answer.status_code == 200 and "Make a take" in answer.text
    assert "connect-src 'self'" in answer.text and "<!--" not in answer.text
    for name, value in PAGE_HEADERS.items():
        assert answer.headers[name].lower() == value.lower()


@pytest.mark.parametrize(
    "path",
    [
        "/",
        "/state",
        "/wrong/state",
        f"/{TOKEN}x/state",
        f"/{TOKEN}/../etc/passwd",
        f"/{TOKEN}/exports/..%2F..%2Fetc%2Fpasswd",
        f"/{TOKEN}/takes/..%2Fstudio.py",
        f"/{TOKEN}/takes/%00",
    ],
)
def test_nothing_else_is_found(client: TestClient, path: str) -> None:
    answer = client.get(f"http://test{path}")
    assert answer.status_code == 404
    assert "root:" not in answer.text


def test_other_methods_do_nothing(client: TestClient) -> None:
    assert client.delete("state").status_code == 405
    assert client.put("meshes").status_code == 405


# ---- takes ---------------------------------------------------------------------------------------


def test_a_take_is_made_and_kept(client: TestClient, take: str) -> None:
    header, arrays = read_take(client.get(f"takes/{take}").content)
    assert header["frames"] == 12 and header["name"] == "1 · happy"
    assert header["facts"]["Emotion"].startswith("happy") and header["facts"]["Seed"] == "3"
    assert arrays["rest"].shape == (state(client)["meshes"][0]["vertices"], 3)


@pytest.mark.parametrize(
    ("name", "starts"),
    [("glb", b"glTF"), ("npz", b"PK"), ("html", b"<!doctype"), ("obj", b"PK"), ("usda", b"PK")],
)
def test_takes_are_downloaded(client: TestClient, take: str, name: str, starts: bytes) -> None:
    answer = client.post(f"takes/{take}/exports", params={"client": "me"}, json={"format": name})
    job = finished(client, answer.json()["id"])
    assert job["state"] == "done", job["message"]
    file = client.get(f"exports/{job['id']}")
    assert file.content.startswith(starts)
    assert file.headers["content-disposition"].startswith("attachment")
    if name == "obj":
        assert len(zipfile.ZipFile(io.BytesIO(file.content)).namelist()) == 12


@pytest.mark.slow
def test_an_uploaded_character_keeps_its_skeleton(client: TestClient, take: str) -> None:
    """What ``animate`` does with a file: the character's own glTF with the motion added."""
    pygltflib = pytest.importorskip("pygltflib")
    resting = ft.Animation(small_face(), np.zeros((1, len(small_face().vertices), 3), np.float32))
    with tempfile.TemporaryDirectory() as folder:
        resting.save(Path(folder) / "character.glb")
        file = pygltflib.GLTF2().load(str(Path(folder) / "character.glb"))
    face = next(n for n, node in enumerate(file.nodes) if node.mesh is not None)
    file.asset.generator = "another program"
    file.nodes += [
        pygltflib.Node(name="hips", children=[len(file.nodes) + 1]),
        pygltflib.Node(name="neck", translation=[0, 1, 0]),
    ]
    file.scenes[0].nodes.append(len(file.nodes) - 2)
    file.skins.append(pygltflib.Skin(joints=[len(file.nodes) - 2, len(file.nodes) - 1]))
    file.nodes[face].skin = 0
    sent = client.post(
        "meshes", params={"name": "hero.glb"}, content=b"".join(file.save_to_bytes())
    )
    assert sent.status_code == 201, sent.text
    wish = {"mesh": sent.json()["id"], "sound": state(client)["sounds"][0]["id"]}
    made = finished(client, client.post("takes", params={"client": "me"}, json=wish).json()["id"])
    assert made["state"] == "done", made["message"]
    job = client.post(
        f"takes/{made['result']}/exports", params={"client": "me"}, json={"format": "glb"}
    )
    done = finished(client, job.json()["id"])
    assert done["state"] == "done", done["message"]
    back = pygltflib.GLTF2().load_from_bytes(client.get(f"exports/{done['id']}").content)
    assert [node.name for node in back.nodes[: len(file.nodes)]] == [n.name for n in file.nodes]
    assert back.skins[0].joints == file.skins[0].joints
    assert back.animations[0].channels and back.meshes[0].primitives[0].targets
    client.delete(f"takes/{made['result']}")


def test_an_unknown_format_is_refused(client: TestClient, take: str) -> None:
    answer = client.post(f"takes/{take}/exports", json={"format": "../fbx"})
    assert answer.status_code == 400 and "glb" in answer.json()["error"]


@pytest.mark.parametrize(
    ("wish", "message"),
    [
        ({"mesh": "nothing"}, "recordings"),
        ({"emotion": 3}, "emotion"),
        ({"emotion": "x" * 3000}, "emotion"),
        ({"intensity": "strong"}, "intensity"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"seed": True}, "seed"),
    ],
)
def test_wishes_of_another_kind_are_refused(
    client: TestClient, take: str, wish: dict[str, Any], message: str
) -> None:
    now = state(client)
    known = {"mesh": now["meshes"][0]["id"], "sound": now["sounds"][0]["id"]}
    whole = wish if "mesh" in wish else known | wish
    answer = client.post("takes", json=whole)
    assert answer.status_code in (400, 404) and message in answer.json()["error"]


def test_an_unknown_emotion_fails_with_the_known_ones(client: TestClient, take: str) -> None:
    now = state(client)
    wish = {"mesh": now["meshes"][0]["id"], "sound": now["sounds"][0]["id"], "emotion": "grumpy"}
    job = finished(client, client.post("takes", params={"client": "me"}, json=wish).json()["id"])
    assert job["state"] == "failed" and "happy" in job["message"]
    assert state(client)["jobs"]  # and the next job finds the worker at its place


@pytest.mark.parametrize("body", [b"", b"[1]", b"{", b'"text"', b"[" * 5000, b"\xff\xfe"])
def test_broken_json_is_refused(client: TestClient, body: bytes) -> None:
    assert client.post("takes", content=body).status_code == 400


# ---- uploads -------------------------------------------------------------------------------------


def test_a_mesh_is_taken_and_named_without_folders(client: TestClient, tmp_path: Path) -> None:
    save_mesh(tmp_path / "face.obj", small_face())
    content = (tmp_path / "face.obj").read_bytes()
    answer = client.post("meshes", params={"name": "..\\up/../my face.obj"}, content=content)
    assert answer.status_code == 201 and answer.json()["name"] == "my face.obj"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("face.gltf", b"{}", "GLB"),
        ("face.exe", b"MZ", "GLB"),
        ("", b"", "GLB"),
        ("face.obj", b"not a mesh", "face.obj"),
        ("face.ply", b"", "face.ply"),
        ("face.glb", b"glTF", "damaged"),
    ],
)
def test_other_meshes_are_refused(
    client: TestClient, name: str, content: bytes, message: str
) -> None:
    answer = client.post("meshes", params={"name": name}, content=content)
    assert answer.status_code == 400
    assert message in answer.json()["error"] and "/tmp" not in answer.json()["error"]


@pytest.mark.slow
def test_a_marked_face_is_where_it_was_marked(client: TestClient, tmp_path: Path) -> None:
    model = load_face_model()
    mesh = small_face()
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    save_mesh(tmp_path / "a.obj", ft.Mesh(mesh.vertices @ turn.T * 7 + 3, mesh.faces.tolist()))
    sent = client.post(
        "meshes", params={"name": "a.obj"}, content=(tmp_path / "a.obj").read_bytes()
    ).json()
    header, arrays = read_take(client.get(f"meshes/{sent['id']}").content)
    assert header["frames"] == 1 and len(arrays["rest"]) == len(mesh.vertices)
    # The page shows the mesh by some similarity, which its vertices tell.
    marks = np.asarray(model.neutral, np.float64)[model.landmarks68]
    home = np.hstack([np.asarray(mesh.vertices), np.ones((len(mesh.vertices), 1))])
    to_page, *_ = np.linalg.lstsq(home, arrays["rest"].astype(np.float64), rcond=None)
    shown = np.hstack([marks, np.ones((68, 1))]) @ to_page
    chosen = shown[[index for index, _ in MARKS]]
    answer = client.post(f"meshes/{sent['id']}/marks", json={"marks": chosen.tolist()})
    assert answer.status_code == 200, answer.text
    found = np.reshape(answer.json()["landmarks"], (68, 3))
    size = np.linalg.norm(to_page[0])  # of a metre of the face in the page
    assert np.linalg.norm(found - shown, axis=1).mean() < 0.003 * size
    assert state(client)["meshes"][-1]["marked"]
    sides = [[3, 2, 1, 0, 4, 6, 5, 7][i] for i in range(8)]
    for wrong in (chosen[sides].tolist(), chosen[:5].tolist(), "here", None):
        refusal = client.post(f"meshes/{sent['id']}/marks", json={"marks": wrong})
        assert refusal.status_code == 400 and refusal.json()["error"]
    assert client.delete(f"meshes/{sent['id']}").status_code == 204
    assert client.get(f"meshes/{sent['id']}").status_code == 404


def test_what_is_not_needed_is_removed(client: TestClient, take: str) -> None:
    mesh, *others = [one["id"] for one in state(client)["meshes"]]
    assert all(client.delete(f"meshes/{other}").status_code == 204 for other in others)
    assert client.delete(f"meshes/{mesh}").json()["error"].startswith("this is the only face")
    sound = client.post("sounds", params={"name": "b.wav"}, content=wav()).json()["id"]
    assert client.delete(f"sounds/{sound}").status_code == 204
    assert sound not in [one["id"] for one in state(client)["sounds"]]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "b.obj"
        save_mesh(file, small_face())
        other = client.post("meshes", params={"name": "b.obj"}, content=file.read_bytes()).json()
    assert "takes on" in client.delete(f"meshes/{mesh}").json()["error"]
    assert client.delete(f"meshes/{other['id']}").status_code == 204
    assert client.delete(f"meshes/{other['id']}").status_code == 404


def test_a_glb_that_names_other_files_is_refused() -> None:
    document = json.dumps({"buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}).encode()
    content = struct.pack("<4sII", b"glTF", 2, 20 + len(document))
    content += struct.pack("<I4s", len(document), b"JSON") + document
    with pytest.raises(Refused, match="other files"):
        read_mesh("face.glb", content, LIMITS)


def test_too_many_vertices_are_refused(tmp_path: Path) -> None:
    save_mesh(tmp_path / "face.obj", small_face())
    with pytest.raises(Refused, match="at most 100 "):
        read_mesh("face.obj", (tmp_path / "face.obj").read_bytes(), Limits(vertices=100))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#EXTM3U\nfile:///etc/passwd", "no WAV"),
        (b"", "no WAV"),
        (b"RIFF\0\0\0\0WAVE", "a.wav"),
        (wav()[:40], "a.wav"),
        (wav(3.2), "at most 3 s"),
    ],
)
def test_other_sounds_are_refused(client: TestClient, content: bytes, message: str) -> None:
    answer = client.post("sounds", params={"name": "a.wav"}, content=content)
    assert answer.status_code == 400 and message in answer.json()["error"]


def test_uploads_that_are_too_large_are_refused_before_they_are_read(client: TestClient) -> None:
    def endless() -> Iterator[bytes]:
        for _ in range(64):
            yield bytes(1 << 16)

    for content in (bytes(LIMITS.upload_bytes + 1), endless()):
        answer = client.post("sounds", content=content)
        assert answer.status_code == 413 and "1 MB" in answer.json()["error"]


def test_mutated_files_never_bring_it_down(tmp_path: Path) -> None:
    save_mesh(tmp_path / "face.obj", small_face())
    save_mesh(tmp_path / "face.ply", small_face())
    originals = {"a.wav": wav(0.05), "a.obj": (tmp_path / "face.obj").read_bytes()[:4000]}
    originals["a.ply"] = (tmp_path / "face.ply").read_bytes()[:4000]
    rng = np.random.default_rng(0)
    for name, original in originals.items():
        read = read_sound if name == "a.wav" else read_mesh
        for _ in range(60):
            content = bytearray(original[: rng.integers(1, len(original) + 1)])
            for at in rng.integers(0, len(content), rng.integers(1, 12)):
                content[at] = rng.integers(0, 256)
            try:
                read(name, bytes(content), LIMITS)
            except Refused as refusal:
                assert str(refusal)


def test_names_are_plain() -> None:
    assert plain_name("../../etc/passwd") == "passwd"
    assert plain_name("a\nb\x00.obj") == "ab.obj"
    assert plain_name("/") == "unnamed" and len(plain_name("x" * 500 + ".obj")) == 80


# ---- jobs ----------------------------------------------------------------------------------------


@pytest.fixture
def queue() -> Iterator[JobQueue]:
    jobs = JobQueue(waiting=2, patience_s=0.6)
    yield jobs
    jobs.close()


def until(condition: Any) -> None:
    for _ in range(200):
        if condition():
            return
        time.sleep(0.02)
    raise AssertionError("it never happened")


def forever(report: Report) -> None:
    while True:
        report(0.5, 1)
        time.sleep(0.01)


def test_a_running_job_is_given_up_at_its_next_step(queue: JobQueue) -> None:
    job = queue.submit(Job("long", "me", forever))
    until(lambda: job.share == 0.5)
    waiting = queue.submit(Job("waits", "me", forever))
    queue.stop(waiting.id)
    queue.stop(job.id)
    until(lambda: job.state == "stopped")
    assert waiting.state == "stopped"


def test_the_job_of_a_page_that_is_gone_makes_place(queue: JobQueue) -> None:
    gone = queue.submit(Job("of nobody", "gone", forever))
    started = time.monotonic()
    until(lambda: gone.state == "stopped")
    assert time.monotonic() - started < 3
    after = queue.submit(Job("next", "me", lambda report: "result"))
    until(lambda: after.state == "done")


def test_no_more_jobs_wait_than_may(queue: JobQueue) -> None:
    jobs = [queue.submit(Job("long", "me", forever)) for _ in range(3)]
    with pytest.raises(Refused, match="waiting already"):
        queue.submit(Job("one more", "me", forever))
    for job in jobs:
        queue.stop(job.id)


def test_a_job_that_fails_leaves_the_worker_alive(queue: JobQueue) -> None:
    def broken(_: Report) -> None:
        raise KeyError("something odd")

    failed = queue.submit(Job("broken", "me", broken))
    after = queue.submit(Job("next", "me", lambda report: 5))
    until(lambda: after.state == "done")
    assert failed.state == "failed" and "odd" in failed.message and after.result == 5


def test_unknown_jobs_are_refused(queue: JobQueue) -> None:
    with pytest.raises(Refused, match="no such job"):
        queue.stop("nothing")
    assert issubclass(GivenUp, Exception)


# ---- live ----------------------------------------------------------------------------------------


def pcm(seconds: float) -> list[bytes]:
    content = wav(seconds)[44:]
    return [content[at : at + 640] for at in range(0, len(content), 640)]


def test_live_speech_comes_back_as_frames(client: TestClient) -> None:
    mesh = state(client)["meshes"][0]["id"]
    with client.websocket_connect(f"/{TOKEN}/live?mesh={mesh}") as socket:
        socket.send_text(json.dumps({"emotion": "happy", "seed": 1}))
        facts = json.loads(socket.receive_text())
        header, arrays = read_take(socket.receive_bytes())
        assert facts["rate_hz"] == 16000 and 0.1 < facts["latency_s"] < 1.5
        assert arrays["targets"].shape[0] == facts["weights"] and "jawOpen" in header["live"]
        for number, block in enumerate(pcm(2.0)):
            socket.send_bytes(block)
            if number == 20:
                socket.send_text(json.dumps({"emotion": "angry", "intensity": 2}))
        size = 8 + 2 * facts["weights"]
        frames: list[tuple[int, float]] = []
        while not frames or frames[-1][0] < 20:
            message = socket.receive_bytes()
            assert len(message) % size == 0
            frames += [
                struct.unpack_from("<If", message, at) for at in range(0, len(message), size)
            ]
    assert [index for index, _ in frames] == list(range(len(frames)))
    np.testing.assert_allclose(
        [t for _, t in frames], np.arange(len(frames)) / facts["fps"], atol=1e-5
    )


@pytest.mark.parametrize(
    "messages",
    [
        [b"\0" * 3],
        [b"\0" * 40000],
        ["no json"],
        ['{"emotion": "grumpy"}'],
        ['{"emotion": 5}'],
    ],
)
def test_hostile_messages_end_their_stream_alone(
    client: TestClient, messages: list[str | bytes]
) -> None:
    mesh = state(client)["meshes"][0]["id"]
    with client.websocket_connect(f"/{TOKEN}/live?mesh={mesh}") as socket:
        socket.send_text("{}")
        socket.receive_text()
        socket.receive_bytes()
        for message in messages:
            socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message)
        with pytest.raises(WebSocketDisconnect) as ended:
            socket.receive_bytes()
    assert ended.value.code == 1008 and ended.value.reason
    assert client.get("state").status_code == 200


def test_one_stream_too_many_is_turned_away(client: TestClient) -> None:
    mesh = state(client)["meshes"][0]["id"]
    with client.websocket_connect(f"/{TOKEN}/live?mesh={mesh}") as first:
        first.send_text("{}")
        first.receive_text()
        with (
            client.websocket_connect(f"/{TOKEN}/live?mesh={mesh}") as second,
            pytest.raises(WebSocketDisconnect) as refused,
        ):
            second.receive_text()
        assert refused.value.code == 1013
        first.receive_bytes()


def test_a_stream_needs_the_token_and_a_mesh(client: TestClient) -> None:
    with (
        pytest.raises(WebSocketDisconnect) as closed,
        client.websocket_connect("/wrong/live?mesh=x") as socket,
    ):
        socket.receive_text()
    assert closed.value.code == 4404
    with client.websocket_connect(f"/{TOKEN}/live?mesh=x") as socket:
        socket.send_text("{}")
        with pytest.raises(WebSocketDisconnect) as ended:
            socket.receive_text()
    assert "meshes" in ended.value.reason


# ---- the end -------------------------------------------------------------------------------------


def test_closing_stops_jobs_and_removes_files(talker: ft.Talker) -> None:
    studio = Studio(talker, small_face(), LIMITS)
    folder = studio._folder
    job = studio.jobs.submit(Job("long", "me", forever))
    until(lambda: job.share == 0.5)
    studio.close()
    assert job.state == "stopped" and not folder.exists()
    assert not [thread for thread in threading.enumerate() if thread is studio.jobs._worker]


def test_as_many_takes_are_kept_as_may(client: TestClient, take: str) -> None:
    now = state(client)
    wish = {"mesh": now["meshes"][0]["id"], "sound": now["sounds"][0]["id"]}
    while len(state(client)["takes"]) < LIMITS.kept:
        job = client.post("takes", params={"client": "me"}, json=wish).json()
        assert finished(client, job["id"])["state"] == "done"
    answer = client.post("takes", json=wish)
    assert answer.status_code == 409 and "remove one" in answer.json()["error"]
    assert client.delete(f"takes/{state(client)['takes'][-1]['id']}").status_code == 204
    assert len(state(client)["takes"]) == LIMITS.kept - 1
