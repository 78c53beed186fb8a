#!/usr/bin/env python3
"""Pictures a second of the page, by its own counter, in a browser without a display.

    python scripts/bench/page.py [--vertices 50000] [--seconds 4]

The mean face with so many vertices says a sentence; the page plays it in a window of a laptop (1440 x 900, at one and
two pixels a point), of a phone (390 x 844 at three) and in a very small one, where filling pixels costs next to nothing.
Prints for each: pictures a second, the share of the pixels that the page draws then, and the page's own work for a
picture in ms. Needs chromium and ``pip install playwright``. Without a graphics card the processor draws.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from animate import face, speech

import freetalk as ft

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "python"))
from browser import Visit, browser

WINDOWS = (
    ("laptop", (1440, 900), 1),
    ("laptop, fine pixels", (1440, 900), 2),
    ("phone", (390, 844), 3),
    ("very small", (320, 240), 1),
)


def animation(num_vertices: int, seconds: float) -> ft.Animation:
    """A sentence on the mean face with so many vertices."""
    vertices, faces = face(num_vertices)
    mesh = ft.Mesh(np.asarray(vertices, np.float64), faces.tolist(), name="face")
    return ft.Talker.from_pretrained("open-small").animate(
        ft.Audio(speech(seconds), 16000), mesh, emotion="happy"
    )


def main() -> None:
    """Prints a line a window."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--vertices", type=int, default=50_000, help="of the face")
    parser.add_argument("--seconds", type=float, default=4.0, help="of speech")
    parser.add_argument("--page", type=Path, help="a page that is there already")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        file = arguments.page
        if file is None:
            file = Path(folder) / "talk.html"
            animation(arguments.vertices, arguments.seconds).save(file)
        with browser() as chromium:
            for name, size, ratio in WINDOWS:
                visit = Visit(chromium, file.resolve().as_uri(), size, device_scale_factor=ratio)
                visit.until("s.ready")
                visit.page.keyboard.press(" ")
                visit.page.wait_for_timeout(7000)  # the page has found its resolution by then
                seen = []
                for _ in range(10):
                    visit.page.wait_for_timeout(500)
                    seen.append(visit.status())
                pictures = np.median([one["pictures"] for one in seen])
                busy = np.median([one["busyMs"] for one in seen])
                quality = seen[-1]["quality"]
                print(
                    f"{name:20s} {size[0]} x {size[1]} x {ratio}: {pictures:.0f} pictures a second, "
                    f"{quality**2:.0%} of the pixels, {busy:.1f} ms of the page's own",
                    flush=True,
                )
                visit.close()


if __name__ == "__main__":
    main()
