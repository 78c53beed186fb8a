"""Where ``freetalk live`` sends its frames: evenly, each when it is due."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from freetalk.rig import FaceRig
    from freetalk.talker import LiveFrame
    from freetalk.talker.senders import Sender

#: Beside what the stream promises: the computing.
_MARGIN_S = 0.05


class PacedFrames:
    """Sends frames as far apart as they were spoken, though they come several at a time.

    Args:
        senders: to whom.
        rig: whose weights the frames carry.
        latency_s: what the stream promises; a frame is due that long after its moment was heard.
    """

    def __init__(self, senders: list[Sender], rig: FaceRig, latency_s: float) -> None:
        self._senders = senders
        self._names = [name for name in rig.names if not name.startswith("corrective_")]
        self._delay_s = latency_s + _MARGIN_S
        self._start: float | None = None
        self._frames: queue.Queue[tuple[float, Mapping[str, float]] | None] = queue.Queue()
        self._thread = threading.Thread(target=self._run, name="freetalk-sender", daemon=True)
        self._thread.start()

    def heard(self, seconds: float) -> None:
        """A block of speech is there; the first sets the clock."""
        if self._start is None:
            self._start = time.perf_counter() - seconds

    def add(self, frames: list[LiveFrame]) -> None:
        """Further frames."""
        for frame in frames:
            assert frame.weights is not None
            weights = dict(zip(self._names, frame.weights.tolist()))
            self._frames.put((frame.time_s, weights))

    def close(self) -> None:
        """Sends what is left, in its time, and closes the senders."""
        self._frames.put(None)
        self._thread.join()
        for sender in self._senders:
            sender.close()

    def _run(self) -> None:
        while (frame := self._frames.get()) is not None:
            moment, weights = frame
            assert self._start is not None
            time.sleep(max(0.0, self._start + moment + self._delay_s - time.perf_counter()))
            for sender in self._senders:
                sender.send(weights, moment)
