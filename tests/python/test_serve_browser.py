"""The page with its server in a browser: speech in, takes made, compared and removed, live speech; skipped without chromium."""

from __future__ import annotations

import shutil
import socket as sockets
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CONTRAST, NAMELESS, Visit, browser
from test_serve import TOKEN, small_face, wav
from test_stm_ablations import SHIPPED
from test_talker import write_weights

import freetalk as ft
from freetalk.corpus.assets import load_face_model
from freetalk.faces import MARKS

pytest.importorskip("uvicorn", reason="pip install 'freetalk[serve]'")

import uvicorn

from freetalk.serve import Studio, make_app


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A running server with small random weights and a small face."""
    weights = write_weights(tmp_path_factory.mktemp("weights"))
    shutil.copy(Path(SHIPPED).parent / "rig_poses.safetensors", weights)
    with pytest.MonkeyPatch.context() as patch, sockets.create_server(("127.0.0.1", 0)) as door:
        patch.setenv("FREETALK_CACHE", str(tmp_path_factory.mktemp("cache")))
        studio = Studio(ft.Talker.from_pretrained(weights), small_face())
        config = uvicorn.Config(make_app(studio, TOKEN), log_level="error", access_log=False)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [door]})
        thread.start()
        yield f"http://127.0.0.1:{door.getsockname()[1]}/{TOKEN}/"
        server.should_exit = True
        thread.join(timeout=30)


@pytest.fixture
def visit(chromium: Any, address: str) -> Iterator[Visit]:
    opened = Visit(chromium, address, (1200, 800), permissions=["microphone"])
    opened.until("s.connected")
    yield opened
    opened.close()


def said(visit: Visit, where: str, text: str) -> None:
    """Waits until a text stands somewhere; the page forbids the code from strings that a driver's own waiting needs."""
    for _ in range(200):
        if text in visit.page.locator(where).inner_text():
            return
        visit.page.wait_for_timeout(100)
    raise AssertionError(f"'{text}' never stood in {where}: {visit.page.inner_text(where)!r}")


def send_speech(visit: Visit, tmp_path: Path) -> None:
    (tmp_path / "hum.wav").write_bytes(wav(1.0))
    visit.page.set_input_files("#sound-file", tmp_path / "hum.wav")
    visit.page.wait_for_selector("#generate:enabled", timeout=30000)


def test_takes_are_made_directed_compared_and_removed(visit: Visit, tmp_path: Path) -> None:
    assert visit.page.inner_text("#empty-text").startswith("Drop a recording")
    send_speech(visit, tmp_path)
    visit.page.focus("#pad")
    for _ in range(20):
        visit.page.keyboard.press("ArrowUp")
    assert visit.page.inner_text("#mixture") == "happy 100 %"
    visit.page.click("#generate")
    visit.until("s.takes.length === 1 && s.ready", 60)
    visit.page.keyboard.press("End")
    visit.page.click("#add-key")
    visit.page.focus("#pad")
    for _ in range(40):
        visit.page.keyboard.press("ArrowDown")
    assert visit.page.locator("#lane button").count() == 2
    visit.page.click("#dice")
    visit.page.click("#generate")
    status = visit.until("s.takes.length === 2", 60)
    assert status["takes"][0].endswith("happy")
    visit.page.locator(".chip").first.click()
    assert visit.until("s.panes.length === 2")["panes"] == ["A", "B"]
    with visit.page.expect_download(timeout=60000) as waiting:
        visit.page.locator("#kept select").first.select_option("glb")
    waiting.value.save_as(tmp_path / "take.glb")
    assert (tmp_path / "take.glb").read_bytes().startswith(b"glTF")
    for _ in range(2):
        visit.page.locator("#kept button").first.click()
        visit.page.wait_for_timeout(1500)
    visit.until("s.takes.length === 0")
    assert visit.page.locator("#empty.idle").is_visible()
    hosts = {url.split("/")[2] for url in visit.requests if url.startswith(("http", "ws"))}
    assert len(hosts) == 1 and not visit.complaints


def test_a_voice_is_recorded(visit: Visit) -> None:
    before = visit.page.locator("#sound option").count()
    visit.page.click("#record")
    visit.page.wait_for_selector("#record.on")
    visit.page.wait_for_timeout(1500)
    visit.page.click("#record")
    visit.page.wait_for_timeout(2000)
    assert "voice 1" in visit.page.locator("#sound").inner_text()
    assert visit.page.locator("#sound option").count() >= before


def test_live_speech_moves_the_face(visit: Visit) -> None:
    visit.page.click("#tab-live-button")
    visit.page.click("#live-start")
    visit.until("s.live && s.received > 3", 120)
    said(visit, "#live-latency", " s")
    visit.page.click("#live-start")
    visit.until("!s.live")
    assert not visit.complaints


def test_a_face_is_marked_on_the_mesh(visit: Visit) -> None:
    mesh = np.asarray(small_face().vertices)
    model = load_face_model()
    marks = np.asarray(model.neutral)[model.landmarks68][[index for index, _ in MARKS]]
    visit.page.click("#mark-face")
    visit.page.wait_for_selector("#view.marking")
    box = visit.page.locator("#view").bounding_box()
    assert box is not None
    # The page's camera: before the middle of the mesh, 22 degrees high.
    middle, extent = (mesh.min(0) + mesh.max(0)) / 2, np.ptp(mesh, axis=0)
    slope, aspect = np.tan(np.deg2rad(11)), box["width"] / box["height"]
    distance = 1.16 * max(extent[1], extent[0] / aspect) / 2 / slope + extent[2] / 2
    for number, mark in enumerate(marks, 1):
        x, y, z = mark - middle
        right, up = np.array([x / aspect, y]) / slope / (distance - z)
        said(visit, "#notice", f"({number} of 8)")
        visit.page.mouse.click(
            box["x"] + box["width"] * (1 + right) / 2, box["y"] + box["height"] * (1 - up) / 2
        )
    said(visit, "#notice", "The face is there")
    said(visit, "#mesh", "marked")
    visit.page.click("#mark-face")
    visit.page.wait_for_selector("#view.marking")
    visit.page.keyboard.press("Escape")
    visit.page.wait_for_selector("#view:not(.marking)")
    assert not visit.complaints


def test_a_refused_file_is_explained(visit: Visit, tmp_path: Path) -> None:
    (tmp_path / "face.obj").write_bytes(b"no mesh")
    visit.page.set_input_files("#mesh-file", tmp_path / "face.obj")
    for _ in range(50):
        visit.page.wait_for_timeout(100)
        if "face.obj" in visit.page.inner_text(
            "#notice"
        ) and "Reading" not in visit.page.inner_text("#notice"):
            break
    assert "face.obj" in visit.page.inner_text("#notice")


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_text_is_readable_and_controls_have_names(chromium: Any, address: str, theme: str) -> None:
    visit = Visit(chromium, address, (390, 844), theme)
    visit.until("s.connected")
    visit.page.click("#panel-toggle")
    for tab in ("make", "live"):
        visit.page.click(f"#tab-{tab}-button")
        assert not [found for found in visit.page.evaluate(CONTRAST) if found["ratio"] < 4.5]
        assert not visit.page.evaluate(NAMELESS)
    visit.close()
