"""Where the frames of a recording lie on disk; only what is asked for is read."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
import numpy.typing as npt

from freetalk.data.dataset import FloatArray
from freetalk.data.errors import DatasetError, MissingFileError, VertexCountError


class FrameSource(Protocol):
    """Frames of one recording, every ``step``-th of the file's.

    Attributes:
        path: the file, for messages.
        num_frames: frames T.
        num_points: points P of a frame.
    """

    path: Path
    num_frames: int
    num_points: int

    def read(self, start: int, stop: int) -> FloatArray:
        """Positions of frames [start, stop), (T, P, 3) float32 in the file's unit."""

    def decimated(self, step: int) -> FrameSource:
        """The same recording, every ``step``-th of the file's frames."""


class NpyFrames:
    """A ``.npy`` of (T, P, 3) or (T, 3 P) floating numbers, opened for each read and never kept.

    Args:
        path: the file.
        num_points: P; 0 takes the file's.
        step: keep every ``step``-th frame.

    Raises:
        MissingFileError, VertexCountError, DatasetError: no such file; other points; no array.
    """

    def __init__(self, path: Path, num_points: int, step: int = 1) -> None:
        self.path, self.step = path, step
        shape, dtype = npy_header(path)
        size = int(np.prod(shape[1:])) if len(shape) in (2, 3) else 0
        if dtype.kind != "f" or size == 0 or size % 3 or (len(shape) == 3 and shape[2] != 3):
            raise VertexCountError(
                f"{path} is {dtype} {shape}; motion is floating numbers of shape (frames, points, 3) "
                "or (frames, 3 * points)"
            )
        self.num_points = num_points or size // 3
        if size != 3 * self.num_points:
            raise VertexCountError(
                f"{path} has {size // 3} points a frame, its mesh has {self.num_points}; the file "
                "belongs to another mesh, or the template does"
            )
        self._file_frames = shape[0]
        self.num_frames = -(-shape[0] // step)

    def decimated(self, step: int) -> NpyFrames:
        """The same file, every ``step``-th frame."""
        changed = copy.copy(self)
        changed.step, changed.num_frames = step, -(-self._file_frames // step)
        return changed

    def read(self, start: int, stop: int) -> FloatArray:
        """Positions of frames [start, stop), (T, P, 3) float32 in the file's unit."""
        array: npt.NDArray[Any] = np.load(self.path, mmap_mode="r", allow_pickle=False)
        rows = array[start * self.step : stop * self.step : self.step]
        return np.array(rows, dtype=np.float32).reshape(-1, self.num_points, 3)


class PackedFrames:
    """Rows of one array that holds all recordings, such as VOCAset's ``data_verts.npy``.

    Args:
        path: the ``.npy`` of (N, P, 3), opened for each read and never kept.
        num_points: P.
        rows: (T,) rows of the recording in the order of its frames.
        step: keep every ``step``-th frame.
    """

    def __init__(
        self, path: Path, num_points: int, rows: npt.NDArray[np.int64], step: int = 1
    ) -> None:
        self.path, self.num_points = path, num_points
        self._all_rows, self._rows = rows, rows[::step]
        self.num_frames = len(self._rows)

    def decimated(self, step: int) -> PackedFrames:
        """The same recording, every ``step``-th frame."""
        return PackedFrames(self.path, self.num_points, self._all_rows, step)

    def read(self, start: int, stop: int) -> FloatArray:
        """Positions of frames [start, stop), (T, P, 3) float32 in the file's unit."""
        array: npt.NDArray[Any] = np.load(self.path, mmap_mode="r", allow_pickle=False)
        return np.asarray(array[self._rows[start:stop]], dtype=np.float32)


def read_header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an open ``.npy``; leaves the file at its numbers."""
    reads = np.lib.format.read_array_header_2_0
    if np.lib.format.read_magic(file) == (1, 0):
        reads = np.lib.format.read_array_header_1_0
    shape, _, dtype = reads(file)
    return shape, dtype


def npy_header(path: Path) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of a ``.npy``, without reading its numbers.

    Raises:
        MissingFileError: no such file.
        DatasetError: no array, or one of objects, or cut short.
    """
    try:
        with path.open("rb") as file:
            shape, dtype = read_header(file)
            needed = file.tell() + dtype.itemsize * int(np.prod(shape, dtype=np.int64))
        found = path.stat().st_size
    except FileNotFoundError:
        raise MissingFileError(f"there is no file {path}") from None
    except (ValueError, EOFError, OSError) as error:
        raise DatasetError(
            f"{path} is no readable array ({error}); fetch or make it again"
        ) from error
    if dtype.hasobject:
        raise DatasetError(f"{path} holds Python objects; expected an array of numbers")
    if found < needed:
        raise DatasetError(
            f"{path} has {found} bytes, its {dtype} {shape} needs {needed}; it is cut short: fetch or make "
            "it again"
        )
    return shape, dtype
