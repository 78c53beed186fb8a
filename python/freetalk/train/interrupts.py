"""Ctrl-C and SIGTERM in a training."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from freetalk.train.progress import notice


@contextmanager
def stop_requests(request: Callable[[], bool]) -> Iterator[None]:
    """The first Ctrl-C (or SIGTERM) ends after the step, the second at once.

    `request` asks for the end and says whether it had been asked for before. ``torchrun`` passes on
    the signal that its processes had already, and ends them after a grace time.
    """
    launched = "TORCHELASTIC_RUN_ID" in os.environ

    def handle(number: int, frame: FrameType | None) -> None:
        repeated = request()
        if repeated and not launched:
            raise KeyboardInterrupt
        if not repeated:
            notice("stopping after this step; once more to stop at once")

    try:
        before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # signals belong to the main thread
        before = {}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
