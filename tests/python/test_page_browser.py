"""The page in a browser: opens from a disk, plays in time with its sound, compares, saves; skipped without chromium."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CONTRAST, NAMELESS, Visit, browser
from page_takes import speaking

import freetalk as ft
from freetalk import page


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as started:
        yield started


@pytest.fixture(scope="module")
def talk(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A page of two takes of 2 s, the second of which opens the mouth by 5 mm less, and a smile."""
    takes = {
        "wide": speaking(50, strength=0.6),
        "narrow": speaking(50, strength=0.3),
        "smile": speaking(50, shape="mouthSmile_L"),
    }
    path = tmp_path_factory.mktemp("page") / "talk.html"
    page.save_page(takes, path, phones=[(0.0, 1.0, "AA"), (1.0, 2.0, "M")])
    return path.as_uri()


@pytest.fixture
def visit(chromium: Any, talk: str) -> Iterator[Visit]:
    opened = Visit(chromium, talk)
    opened.until("s.ready")
    yield opened
    opened.close()


def pixels(visit: Visit) -> np.ndarray:
    from PIL import Image

    box = visit.page.locator("#view").bounding_box()
    return np.asarray(Image.open(io.BytesIO(visit.page.screenshot(clip=box))).convert("RGB"), int)


def test_it_opens_from_a_disk_and_asks_nobody(visit: Visit) -> None:
    assert visit.status()["takes"] == ["wide", "narrow", "smile"]
    others = [url for url in visit.requests if not url.startswith(("file:", "data:", "blob:"))]
    assert not others and not visit.complaints


def test_picture_follows_sound(visit: Visit) -> None:
    visit.page.keyboard.press("1")
    visit.page.keyboard.press("Space")
    status = visit.until("s.playing && s.audible && s.time > 0.4")
    lags = [status["time"] - status["shown"] for status in _samples(visit, 12)]
    # What is shown was drawn for the sound of that moment; it gets older only until the next picture is drawn.
    drawn = visit.status()["pictures"]
    assert min(lags) < 1 / 25 + 1 / max(drawn, 1)
    visit.page.keyboard.press("Space")
    status = visit.until("!s.playing && Math.abs(s.time - s.shown) < 1e-6")
    assert 0.4 < status["time"] <= 2.0


def _samples(visit: Visit, count: int) -> Iterator[dict[str, Any]]:
    for _ in range(count):
        visit.page.wait_for_timeout(40)
        yield visit.status()


def test_frames_are_stepped_and_the_mouth_moves(visit: Visit) -> None:
    visit.page.keyboard.press("1")
    visit.page.wait_for_timeout(600)
    still = pixels(visit)
    for _ in range(3):
        visit.page.keyboard.press("ArrowRight")
    assert visit.until("Math.abs(s.shown - 3 / 25) < 1e-6")
    visit.page.keyboard.press("Shift+ArrowRight")
    visit.until("Math.abs(s.shown - 28 / 25) < 1e-6")
    visit.page.wait_for_timeout(400)
    assert (np.abs(pixels(visit) - still).max(axis=2) > 30).mean() > 0.002


def test_a_moving_head_is_drawn_where_it_is(chromium: Any, tmp_path: Path) -> None:
    face = speaking(10, strength=0.0)
    head = np.tile(np.eye(4), (10, 1, 1))
    head[:, 0, 3] = np.linspace(0, 0.045, 10)  # m, to the right
    options = {"fps": 25.0, "metadata": face.metadata, "head": head}
    page.save_page(ft.Animation(face.mesh, face.displacements, **options), tmp_path / "head.html")
    visit = Visit(chromium, (tmp_path / "head.html").as_uri())
    visit.until("s.ready")
    places = []
    for steps in (0, 9):
        for _ in range(steps):
            visit.page.keyboard.press("ArrowRight")
        visit.page.wait_for_timeout(600)
        image = pixels(visit)
        skin = image[..., 0] > image[..., 2] + 25
        places.append(np.flatnonzero(skin.any(axis=1)).mean() + 1j * np.nonzero(skin)[1].mean())
    complaints = visit.complaints
    visit.close()
    moved = places[1] - places[0]
    assert not complaints and moved.imag > 20 and abs(moved.real) < 5, moved


def test_takes_are_shown_alone_beside_each_other_and_measured(visit: Visit) -> None:
    visit.page.keyboard.press("2")
    assert visit.until("s.panes.join() === 'B'")["heard"] == "B"
    visit.page.keyboard.press("Shift+Digit1")
    assert visit.until("s.panes.join() === 'A,B'")["heard"] == "B"
    visit.page.keyboard.press("End")
    visit.page.keyboard.press("Home")
    for _ in range(25):
        visit.page.keyboard.press("ArrowRight")
    visit.until("Math.abs(s.shown - 1) < 1e-6")
    visit.page.select_option("#truth", "take-0")
    visit.until("s.truth === 'A'")
    visit.page.wait_for_timeout(500)
    note = visit.page.locator(".pane small").nth(1).inner_text()
    wide, narrow = speaking(50, strength=0.6), speaking(50, strength=0.3)
    off = 1e3 * np.linalg.norm(wide.displacements[25] - narrow.displacements[25], axis=1)
    mean, largest = (float(word) for word in note.replace(" mm, at most", "").split())
    assert mean == pytest.approx(off.mean(), abs=0.1)
    assert largest == pytest.approx(off.max(), abs=0.2)


def test_a_picture_and_a_video_are_saved(visit: Visit, tmp_path: Path) -> None:
    visit.page.keyboard.press("1")
    with visit.page.expect_download() as waiting:
        visit.page.keyboard.press("p")
    waiting.value.save_as(tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    with visit.page.expect_download(timeout=60000) as waiting:
        visit.page.keyboard.press("v")
    waiting.value.save_as(tmp_path / waiting.value.suggested_filename)
    assert waiting.value.suggested_filename.startswith("talk.")
    assert (tmp_path / waiting.value.suggested_filename).stat().st_size > 5000
    assert not visit.complaints


def test_the_speed_and_what_is_repeated_are_chosen(visit: Visit) -> None:
    box = visit.page.locator("#timeline").bounding_box()
    middle = box["y"] + box["height"] / 2
    visit.page.keyboard.down("Shift")
    visit.page.mouse.move(box["x"] + 0.25 * box["width"], middle)
    visit.page.mouse.down()
    visit.page.mouse.move(box["x"] + 0.5 * box["width"], middle, steps=4)
    visit.page.mouse.up()
    visit.page.keyboard.up("Shift")
    visit.page.keyboard.press("<")
    visit.page.keyboard.press("Space")
    visit.until("s.playing")
    shown = [status["shown"] for status in _samples(visit, 60)]
    assert min(shown) >= 0.45 and max(shown) <= 1.1


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_text_is_readable_and_controls_have_names(chromium: Any, talk: str, theme: str) -> None:
    visit = Visit(chromium, talk, (1280, 800), theme)
    visit.until("s.ready")
    for tab in ("view", "shapes", "about"):
        visit.page.click(f"#tab-{tab}-button")
        faint = [found for found in visit.page.evaluate(CONTRAST) if found["ratio"] < 4.5]
        assert not faint
        assert not visit.page.evaluate(NAMELESS)
    visit.close()


@pytest.mark.parametrize("size", [(390, 844), (820, 1180), (1440, 900)])
def test_nothing_hangs_over_the_edge(chromium: Any, talk: str, size: tuple[int, int]) -> None:
    visit = Visit(chromium, talk, size)
    visit.until("s.ready")
    width, height = visit.page.evaluate(
        "() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    )
    assert (width, height) == size
    view = visit.page.locator("#view").bounding_box()
    assert view["width"] > 0.6 * size[0] and view["height"] > 0.4 * size[1]
    visit.close()


def test_a_damaged_page_says_so(chromium: Any, talk: str, tmp_path: Path) -> None:
    from urllib.parse import urlparse

    text = Path(urlparse(talk).path).read_text()
    start = text.index('class="take">') + 13
    broken = tmp_path / "broken.html"
    broken.write_text(text[: start + 400] + text[text.index("</script>", start) :])
    visit = Visit(chromium, broken.as_uri())
    visit.page.wait_for_selector("#empty.failed")
    assert "damaged" in visit.page.inner_text("#empty-text")
    visit.close()


def test_fifty_thousand_vertices_are_moved_in_time(chromium: Any, tmp_path: Path) -> None:
    """The page's own work for a frame: with a graphics card nothing else limits it."""
    side = 224
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, side), np.linspace(-0.1, 0.1, side))
    vertices = np.stack([x, y, 0 * x], axis=2).reshape(-1, 3)
    first = np.arange(side * (side - 1)).reshape(-1, side)[:, :-1].ravel()
    corners = np.stack([first, first + 1, first + side + 1, first + side], axis=1)
    rng = np.random.default_rng(0)
    waves = rng.normal(size=(48, len(vertices), 3)) * 1e-3
    motion = (rng.normal(size=(60, 48)) @ waves.reshape(48, -1)).reshape(60, -1, 3)
    animation = ft.Animation(ft.Mesh(vertices, corners.tolist()), motion.astype(np.float32))
    page.save_page(animation, tmp_path / "large.html")
    visit = Visit(chromium, (tmp_path / "large.html").as_uri(), (200, 200))
    visit.until("s.ready")
    times = []
    for _ in range(7):
        visit.page.keyboard.press("ArrowRight")
        visit.page.wait_for_timeout(300)
        times.append(visit.status()["busyMs"])
    visit.close()
    assert min(times) < 33.3, times
