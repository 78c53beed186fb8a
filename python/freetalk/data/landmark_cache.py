"""Landmarks of a dataset on disk: picked from its vertices once, then read in milliseconds."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk._files import beside
from freetalk.data.dataset import NUM_LANDMARKS, FloatArray


class LandmarkCache:
    """One array of all frames and a flag a sequence; both grow into place as sequences are asked for.

    Several processes may share it: each writes the same numbers, and the flag once they are on the disk,
    so that a crash leaves no sequence that is marked and not there.

    Args:
        path: folder of the two files, made if need be.
        num_frames: frames of all sequences together.
        num_sequences: sequences.
    """

    def __init__(self, path: Path, num_frames: int, num_sequences: int) -> None:
        path.mkdir(parents=True, exist_ok=True)
        self._landmarks = _shared(
            path / "landmarks.npy", (num_frames, NUM_LANDMARKS, 3), np.float32
        )
        self._done = _shared(path / "done.npy", (num_sequences,), np.uint8)

    def get(
        self, index: int, first: int, count: int, compute: Callable[[], FloatArray]
    ) -> npt.NDArray[np.float32]:
        """Landmarks (count, 68, 3) of a sequence whose frames start at ``first``; a view of the file."""
        rows = self._landmarks[first : first + count]
        if not self._done[index]:
            rows[:] = compute()
            self._landmarks.flush()
            self._done[index] = 1
            self._done.flush()
        return rows


def _shared(path: Path, shape: tuple[int, ...], dtype: type) -> np.memmap[Any, Any]:
    """An array on disk that is there whole or not at all; zeros take no space until written."""
    if not path.is_file():
        temporary = beside(path)
        np.lib.format.open_memmap(temporary, mode="w+", dtype=dtype, shape=shape).flush()
        try:
            os.link(temporary, path)  # the first process wins; a rename would part the others' view
        except FileExistsError:
            pass
        finally:
            temporary.unlink()
    return np.lib.format.open_memmap(path, mode="r+")
