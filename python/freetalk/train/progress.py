"""What a training shows while it runs (a bar on the terminal, curves, pictures), and how it is told to stop."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from freetalk.train.config import TrainingConfig
from freetalk.train.curves import Curves


def is_main_process() -> bool:
    """Whether this is the one of several processes that speaks and writes."""
    return int(os.environ.get("RANK", "0")) == 0


def notice(text: str) -> None:
    """A line beside the bar, from one of the processes that train together."""
    if is_main_process():
        tqdm.write(text, file=sys.stderr)


class Progress:
    """The bar and the curves of the main process; other processes show nothing.

    Args:
        config: of the training.
        out: its output folder.
        step: where it starts or goes on; later points of an earlier run are dropped.
        steps: where it ends.
        shown: whether this process shows anything.
    """

    def __init__(
        self, config: TrainingConfig, out: Path, step: int, steps: int, shown: bool
    ) -> None:
        self._options, self._steps = config.loop, steps
        self._kind = config.kind
        self._shown = shown
        self._bar: Any = tqdm(
            total=1.0,
            desc=config.kind,
            bar_format="{percentage:3.0f}%|{bar:20}| {desc}",
            dynamic_ncols=True,
            mininterval=0.0,
            disable=not shown,
        )
        self._seen = step
        self._seen_at = time.perf_counter()
        if shown:
            self._curves = Curves(config.loop.loggers, out, config.to_dict(), step)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
        if self._shown:
            self._curves.close()

    def show(
        self, step: int, elapsed_s: float, done: float, terms: dict[str, float], logged: bool
    ) -> None:
        """Moves the bar, and adds a point to the curves.

        Args:
            step: finished steps.
            elapsed_s: seconds of training so far.
            done: share of the training that is done.
            terms: values of the step.
            logged: whether the curves get them.
        """
        if not self._shown:
            return
        now = time.perf_counter()
        rate = (step - self._seen) * self._options.batch_size / max(now - self._seen_at, 1e-9)
        if logged:
            values = {**terms, "items_per_second": rate}
            self._curves.log({f"train/{name}": value for name, value in values.items()}, step)
        left = elapsed_s * max(1 - done, 0.0) / done
        self._bar.n = min(done, 1.0)
        self._bar.set_description_str(
            f"{self._kind} step {step}/{self._steps}, loss {terms['loss']:.4g}, {rate:.1f} items/s, "
            f"{_clock(elapsed_s)} so far, {_clock(left)} left"
        )
        self._seen, self._seen_at = step, now

    def show_scores(self, step: int, scores: dict[str, float], seconds: float) -> None:
        """Adds a validation's scores to the curves and prints them."""
        self._curves.log({f"val/{name}": value for name, value in scores.items()}, step)
        shown = ", ".join(f"{name} {value:.4g}" for name, value in scores.items())
        tqdm.write(f"step {step}: {shown} ({seconds:.1f} s)", file=sys.stderr)
        self._seen_at += seconds  # not training

    def show_picture(self, step: int, picture: npt.NDArray[np.uint8], seconds: float) -> None:
        """Adds a picture (H, W, 3) of a sample."""
        self._curves.picture(picture, step)
        self._seen_at += seconds


def _clock(seconds: float) -> str:
    minutes = round(seconds) // 60
    return f"{minutes // 60}:{minutes % 60:02d}:{round(seconds) % 60:02d}"


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
