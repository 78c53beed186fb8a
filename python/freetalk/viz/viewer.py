"""A window that plays an animation in a loop."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

from freetalk.viz.renderer import FaceRenderer, View
from freetalk.viz.sequence import as_sequence

_TICK_MS = 15


def show(animation: Any, size: tuple[int, int] = (720, 720), view: View | None = None) -> None:
    """Plays an animation, without sound, in a window that can be turned with the mouse; Q closes it.

    Args:
        animation: ``freetalk.Animation``, :class:`Sequence` or path of an animation ``.npz``.
        size: (width, height) in pixels.
        view: Camera and look at the start.

    Raises:
        RuntimeError: There is no display.
    """
    if sys.platform.startswith("linux") and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise RuntimeError("no display to open a window on: render to a file (--png, --mp4)")
    sequence = as_sequence(animation)
    with FaceRenderer(sequence, size, view, off_screen=False) as renderer:
        start = time.perf_counter()

        def advance(_: int) -> None:
            elapsed = (time.perf_counter() - start) % max(sequence.duration_s, 1e-6)
            renderer.move(sequence.at_time(elapsed))

        renderer.plotter.add_timer_event(max_steps=2**31 - 1, duration=_TICK_MS, callback=advance)
        renderer.plotter.show()
