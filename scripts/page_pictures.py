#!/usr/bin/env python3
"""Draws the pictures of docs/page.md: the page in six states, in a real browser.

    python scripts/page_pictures.py [--out docs/page]

play.webp     a take at the moment of its widest motion
curves.webp   ARKit's weights over time, light
compare.webp  two takes side by side, one measured against the other
start.webp    `freetalk serve` as it opens
create.webp   `freetalk serve`: emotions over time, takes that are kept
phone.webp    a take on a phone

Needs chromium, playwright and the extras [serve]. Takes some minutes of CPU.
"""

from __future__ import annotations

import argparse
import io
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from PIL import Image

import freetalk as ft
from freetalk import page
from freetalk.corpus import assets, mean_face
from freetalk.serve import Studio, make_app

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from browser import Visit, browser  # noqa: E402

DESK, TALL, PHONE = (1280, 760), (1280, 1020), (390, 780)
SECONDS = 3.0  # of speech
TOKEN = "pictures"


def main() -> None:
    """Makes takes, visits the page, saves pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "page")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    talker = ft.Talker.from_pretrained("open-small")
    vertices, faces = mean_face("full")
    mesh = ft.Mesh(vertices, faces.tolist(), name="face")
    whole = ft.load_audio(assets.speech_clip())
    clip = ft.Audio(whole.samples[: int(SECONDS * whole.sample_rate_hz)], whole.sample_rate_hz)
    face = talker.prepare(mesh)
    takes = {emotion: face.animate(clip, emotion=emotion) for emotion in ("happy", "angry")}
    with tempfile.TemporaryDirectory() as folder, browser() as chromium:
        file, speech = Path(folder) / "talk.html", Path(folder) / "speech.wav"
        ft.audio.save_wav(speech, clip)
        page.save_page(takes, file)
        player(chromium, file.as_uri(), takes["happy"], out)
        with served(Studio(talker, mesh)) as address:
            studio(chromium, address, speech, out)


def player(chromium: Any, address: str, animation: ft.Animation, out: Path) -> None:
    """The page on disk."""
    widest = animation.displacements.norm(dim=2).amax(dim=1).argmax().item() / animation.fps
    for name, size, theme in (
        ("play", DESK, "dark"),
        ("curves", DESK, "light"),
        ("compare", DESK, "dark"),
        ("phone", PHONE, "dark"),
    ):
        visit = Visit(chromium, address, size, theme)
        visit.until("s.ready")
        visit.page.keyboard.press("1")
        if name == "curves":
            visit.page.click("#tab-shapes-button")
        if name == "compare":
            visit.page.keyboard.press("2")
            visit.page.keyboard.press("Shift+Digit1")
            visit.until("s.panes.length === 2")
            visit.page.select_option("#truth", "take-0")
        seek(visit, widest / animation.duration_s)
        save(visit, out / f"{name}.webp")
        visit.close()


def studio(chromium: Any, address: str, speech: Path, out: Path) -> None:
    """The page with its server."""
    visit = Visit(chromium, address, TALL)
    visit.until("s.connected")
    save(visit, out / "start.webp")
    visit.page.set_input_files("#sound-file", speech)
    visit.page.wait_for_selector("#generate:enabled", timeout=60000)
    visit.page.focus("#pad")
    for _ in range(14):
        visit.page.keyboard.press("ArrowUp")
    visit.page.click("#generate")
    visit.until("s.takes.length === 1 && s.ready", 600)
    seek(visit, 0.5)
    visit.page.click("#add-key")
    visit.page.focus("#pad")
    for _ in range(20):
        visit.page.keyboard.press("ArrowRight")
    visit.page.click("#generate")
    visit.until("s.takes.length === 2", 600)
    visit.page.evaluate("() => document.getElementById('choose-sound').scrollIntoView()")
    save(visit, out / "create.webp")
    visit.close()


def seek(visit: Visit, share: float) -> None:
    """Clicks into the timeline."""
    box = visit.page.locator("#timeline").bounding_box()
    visit.page.mouse.click(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
    visit.page.mouse.move(1, 1)


def save(visit: Visit, path: Path) -> None:
    """Takes the picture once everything has settled."""
    visit.page.wait_for_timeout(1500)
    picture = Image.open(io.BytesIO(visit.page.screenshot()))
    picture.convert("RGB").save(path, quality=82, method=6)
    print(f"{path} {path.stat().st_size / 1e3:.0f} kB; {visit.complaints or 'no complaint'}")


@contextmanager
def served(studio: Studio) -> Iterator[str]:
    """The address of a running server."""
    with socket.create_server(("127.0.0.1", 0)) as door:
        config = uvicorn.Config(make_app(studio, TOKEN), log_level="error", access_log=False)
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [door]})
        thread.start()
        yield f"http://127.0.0.1:{door.getsockname()[1]}/{TOKEN}/"
        server.should_exit = True
        thread.join(timeout=30)


if __name__ == "__main__":
    main()
