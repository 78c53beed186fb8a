"""Progress of one long native call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

ShareProgress = Callable[[float], None]
"""Is given the finished share in (0, 1]; may raise to stop."""


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
