"""Progress of long native calls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from tqdm import tqdm

ShareProgress = Callable[[float], None]
"""Is given the finished share in (0, 1]; may raise to stop."""
Progress = Callable[[float, float], None]
"""Is given (done, total); may raise to stop."""


@contextmanager
def progress_bar(
    progress: bool | ShareProgress | None, description: str
) -> Iterator[ShareProgress | None]:
    """What to hand to a native call that reports its finished share.

    Args:
        progress: True for a bar on a terminal that appears after two seconds, a callback to be used
            as it is, False or None for nothing.
        description: in front of the bar.
    """
    if progress is None or isinstance(progress, bool):
        if not progress:
            yield None
            return
        with tqdm(
            total=1.0,
            desc=description,
            delay=2.0,
            leave=False,
            disable=None,
            bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}",
        ) as bar:
            yield lambda share: bar.update(share - bar.n)
        return
    yield progress


class StageProgress:
    """Stages of the native pipeline as one bar or one callback.

    Args:
        progress: a bar on a terminal, nothing, or a callback (done, total).
        parts: stages in order and their shares, each part as long as the others.
    """

    def __init__(self, progress: bool | Progress | None, *parts: dict[str, float]) -> None:
        self._callback = progress if callable(progress) else None
        self._begin: dict[str, tuple[float, float]] = {}
        done = 0.0
        for part in parts:
            for stage, share in part.items():
                self._begin[stage] = (done, share / len(parts))
                done += share / len(parts)
        self._bar: Any = None
        if progress is True:
            self._bar = tqdm(total=1.0, desc="animating", leave=False, disable=None)
            self._bar.bar_format = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}"

    def __enter__(self) -> StageProgress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def update(self, stage: str, fraction: float) -> None:
        """Called by the native pipeline."""
        before, share = self._begin[stage]
        done = before + share * fraction
        if self._callback is not None:
            self._callback(done, 1.0)
        if self._bar is not None:
            self._bar.set_description(stage, refresh=False)
            self._bar.n = done
            self._bar.refresh()
