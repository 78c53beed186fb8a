"""Writes the packed layout of :mod:`freetalk.data.pack`.

:class:`PackWriter` works in a hidden folder beside the one to make, takes note of what has reached the disk, goes on
there after a stop, and renames the folder when all is there.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from freetalk._files import flush, write_text
from freetalk.data.errors import DatasetError, NotFiniteError
from freetalk.data.landmarks import NUM_LANDMARKS
from freetalk.data.pack import FORMAT, SAMPLE_RATE_HZ, VERSION, Array, FloatArray, digest_of

#: What may be replaced: this one, and that of corpora before it.
_FORMATS = (FORMAT, "freetalk-open-corpus")
#: Appended bytes after which the journal is brought up to date.
_COMMIT_BYTES = 64 << 20
_COMMIT_TAKES = 256


@dataclass(frozen=True)
class PackedTake:
    """What is written of a take.

    Attributes:
        landmarks: (T, 68, 3) displacements, m.
        motion: (T, V, 3) displacements, m, or (T, E) factors; ``None`` where the landmarks are all.
        samples: (S,) int16 at 16 kHz.
        scans: (T, P, 3) points of each frame's surface, m; ``None`` where frames are no scans.
    """

    landmarks: FloatArray
    motion: FloatArray | None
    samples: npt.NDArray[np.int16]
    scans: Array | None = None

    @property
    def largest_mm(self) -> float:
        """How far a landmark moves at most."""
        return round(1000 * float(np.linalg.norm(self.landmarks, axis=-1).max()), 2)


class PackWriter:
    """Writes a packed folder take by take; a call that was stopped goes on when it is made again.

    Args:
        out: the folder to make.
        key: what is written; an unfinished or finished folder of another key is not touched.
        replace: take the place of a finished folder of another key.

    Raises:
        DatasetError: `out` holds something else, or another process writes it.
        OSError: the disk is full or fails; what was noted until then is gone on from.
    """

    def __init__(self, out: Path, key: Mapping[str, Any], *, replace: bool = False) -> None:
        self.out, self._key, self._replace = out.resolve(), dict(key), replace
        self.work = self.out.with_name(f".{self.out.name}.partial")
        self.sequences: list[dict[str, Any]] = []
        self.excluded: dict[str, str] = {}
        self.complete = False
        self._added: set[str] = set()
        self._files: dict[str, _GrowingArray] = {}
        self._phones: dict[str, Any] = {}
        self._sounds: dict[str, tuple[int, int]] = {}
        self._pending: list[str] = []
        self._pending_bytes = 0

    def __enter__(self) -> PackWriter:
        self._check_out()
        if self.complete:
            return self
        self._lock = _locked(self.work)
        self._check_out()  # another may have finished it while the lock was taken
        if self.complete:
            self._discard()
            return self
        lines = self._read_journal() or [json.dumps(self._key)]
        write_text(self.work / "journal", "\n".join(lines) + "\n")
        self._journal = (self.work / "journal").open("a", encoding="utf-8")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self.complete:
            try:
                if kind is None or not issubclass(kind, OSError):
                    self._commit()
            finally:
                self._close()

    def knows(self, name: str) -> bool:
        """Whether a take was added or excluded before."""
        return name in self.excluded or name in self._added

    def add(
        self,
        entry: Mapping[str, Any],
        landmarks: FloatArray,
        motion: Array | None,
        samples: npt.NDArray[np.int16],
        *,
        scans: Array | None = None,
        sound: str = "",
        phones: list[Any] | None = None,
    ) -> None:
        """Appends a take.

        Args:
            entry: of the manifest, with ``id``; where its frames and samples lie is added.
            landmarks: (T, 68, 3) displacements, m.
            motion: (T, V, 3) displacements, m, or (T, E) factors.
            samples: (S,) at 16 kHz; empty where there is no sound, or where `sound` was given before.
            scans: (T, P, 3) points of each frame's surface, m; where frames are scans.
            sound: takes of the same name share the first one's samples.
            phones: (start in s, end in s, label).

        Raises:
            NotFiniteError: a frame holds NaN or infinity.
        """
        arrays: dict[str, Array] = {"landmarks": np.asarray(landmarks, np.float32)}
        if motion is not None:
            arrays["motion"] = np.asarray(motion, np.float16 if motion.ndim == 3 else np.float32)
        if scans is not None:
            arrays["scans"] = np.asarray(scans, np.float16)
        for array in arrays.values():
            finite = np.isfinite(array).reshape(len(array), -1).all(axis=1)
            if not finite.all():
                frame = int(np.flatnonzero(~finite)[0])
                raise NotFiniteError(f"sequence {entry['id']}, frame {frame} holds NaN or infinity")
        audio = self._file("audio", np.zeros(0, np.int16))
        if sound in self._sounds:
            first, count = self._sounds[sound]
            heard = audio.read(first, count)
        else:
            first, count = audio.rows, len(samples)
            heard = arrays["audio"] = np.asarray(samples, np.int16)
        line = {
            **entry,
            "start_frame": self._file("landmarks", arrays["landmarks"]).rows,
            "num_frames": len(landmarks),
            "first_sample": first,
            "num_samples": count,
            "sha256": digest_of(
                [*(arrays[n] for n in ("landmarks", "motion", "scans") if n in arrays), heard]
            ),
        }
        for name, array in arrays.items():
            self._file(name, array).append(array)
            self._pending_bytes += array.nbytes
        self._note({"take": line, "sound": sound, "phones": phones})

    def exclude(self, name: str, reason: str) -> None:
        """Notes that a take is left out, and why."""
        self._note({"excluded": name, "reason": reason})

    def finish(
        self,
        manifest: Mapping[str, Any],
        identities: FloatArray,
        topologies: Mapping[str, Mapping[str, Array]],
        **extras: Array,
    ) -> Path:
        """Writes what belongs to no single take, and makes the folder appear.

        Args:
            manifest: its other fields.
            identities: (I, K) coefficients.
            topologies: arrays of each file below ``topologies``.
            extras: arrays that not every dataset has.
        """
        self._commit()
        self._close_files()
        np.save(self.work / "identities.npy", identities.astype(np.float32))
        (self.work / "topologies").mkdir(exist_ok=True)
        for name, arrays in topologies.items():
            np.savez(self.work / "topologies" / f"{name}.npz", **arrays)  # type: ignore[arg-type]
        if extras:
            np.savez(self.work / "extras.npz", **extras)  # type: ignore[arg-type]
        if self._phones:
            (self.work / "phones.json").write_text(json.dumps(self._phones))
        content = {
            "format": FORMAT,
            "version": VERSION,
            "key": self._key,
            "sample_rate_hz": SAMPLE_RATE_HZ,
            **manifest,
            "sequences": self.sequences,
            "excluded": [{"id": name, "reason": reason} for name, reason in self.excluded.items()],
        }
        (self.work / "manifest.json").write_text(json.dumps(content, indent=1))
        for path in self.work.rglob("*"):
            flush(path)
        if self._replace and self.out.exists():
            shutil.rmtree(self.out)
        self.work.rename(self.out)
        flush(self.out.parent)
        self.complete = True
        for name in ("journal", "lock"):
            (self.out / name).unlink()
        self._close()
        return self.out

    def _check_out(self) -> None:
        """Sees whether the folder is there already; complains where it is something else."""
        path, found = self.out / "manifest.json", {}
        if path.is_file():
            with contextlib.suppress(ValueError):
                found = json.loads(path.read_text())
        if str(found.get("format", "")) not in _FORMATS:
            if self.out.exists() and any(self.out.iterdir()):
                raise DatasetError(f"{self.out} exists and is no dataset: give another --out")
            return
        self.complete = found.get("key") == json.loads(json.dumps(self._key))
        if not self.complete and not self._replace:
            raise DatasetError(
                f"{self.out} holds another dataset: give another --out, or delete it"
            )

    def _read_journal(self) -> list[str]:
        """Takes over what an earlier call has brought to the disk; returns the journal's lines."""
        path = self.work / "journal"
        lines = path.read_text().splitlines() if path.is_file() else []
        kept: list[str] = []
        for line in lines:
            try:
                content = json.loads(line)
            except ValueError:
                break  # cut off where the writer was
            if not kept:
                if content != json.loads(json.dumps(self._key)):
                    raise DatasetError(
                        f"{self.work} is the unfinished work of another source or other options; delete it to "
                        "start anew"
                    )
            else:
                self._take_over(content)
            kept.append(line)
        return kept

    def _note(self, content: dict[str, Any]) -> None:
        self._take_over(content)
        self._pending.append(json.dumps(content))
        if self._pending_bytes > _COMMIT_BYTES or len(self._pending) >= _COMMIT_TAKES:
            self._commit()

    def _take_over(self, content: dict[str, Any]) -> None:
        if "excluded" in content:
            self.excluded[content["excluded"]] = content["reason"]
            return
        entry = content["take"]
        self._added.add(entry["id"])
        self.sequences.append(entry)
        if content["phones"]:
            self._phones[entry["id"]] = content["phones"]
        if content["sound"]:
            self._sounds[content["sound"]] = entry["first_sample"], entry["num_samples"]

    def _file(self, name: str, array: Array) -> _GrowingArray:
        if name not in self._files:
            last = {"audio": ("first_sample", "num_samples")}.get(
                name, ("start_frame", "num_frames")
            )
            rows = max((e[last[0]] + e[last[1]] for e in self.sequences), default=0)
            self._files[name] = _GrowingArray(
                self.work / f"{name}.npy", array.dtype, array.shape[1:], rows
            )
        return self._files[name]

    def _commit(self) -> None:
        """Brings the arrays to the disk, then the note of them."""
        if not self._pending:
            return
        for file in self._files.values():
            file.flush()
        self._journal.write("\n".join(self._pending) + "\n")
        _flush(self._journal)
        self._pending, self._pending_bytes = [], 0

    def _close_files(self) -> None:
        for name, shape in (("landmarks", (0, NUM_LANDMARKS, 3)), ("audio", (0,))):
            self._file(name, np.zeros(shape, np.float32 if name == "landmarks" else np.int16))
        while self._files:
            self._files.popitem()[1].close()

    def _discard(self) -> None:
        shutil.rmtree(self.work, ignore_errors=True)
        self._lock.close()

    def _close(self) -> None:
        files: list[IO[Any]] = [array.file for array in self._files.values()]
        for file in [*files, self._journal, self._lock]:
            with contextlib.suppress(OSError):  # a full disk has no room for what is buffered
                file.close()


class _GrowingArray:
    """An ``.npy`` that rows are appended to; its header is right once it is closed."""

    def __init__(
        self, path: Path, dtype: np.dtype[Any], row_shape: tuple[int, ...], rows: int
    ) -> None:
        self.rows, self._dtype, self._row_shape = rows, dtype, row_shape
        self._row_bytes = dtype.itemsize * int(np.prod(row_shape, dtype=np.int64))
        self.file: IO[bytes] = path.open("r+b" if path.is_file() else "w+b")
        self._write_header()
        self._start = self.file.tell()
        self.file.truncate(self._start + rows * self._row_bytes)  # what was not noted goes
        self.file.seek(0, os.SEEK_END)

    def append(self, array: Array) -> None:
        if (array.dtype, array.shape[1:]) != (self._dtype, self._row_shape):
            raise ValueError(
                f"{self.file.name} has rows of {self._dtype} {self._row_shape}, got {array.dtype} {array.shape[1:]}"
            )
        self.file.write(np.ascontiguousarray(array).data)
        self.rows += len(array)

    def read(self, first: int, count: int) -> Array:
        """Rows that were appended before."""
        self.file.seek(self._start + first * self._row_bytes)
        content = self.file.read(count * self._row_bytes)
        self.file.seek(0, os.SEEK_END)
        return np.frombuffer(content, self._dtype).reshape(count, *self._row_shape)

    def flush(self) -> None:
        _flush(self.file)

    def close(self) -> None:
        self.file.seek(0)
        self._write_header()
        self.flush()
        self.file.close()

    def _write_header(self) -> None:
        shape = (self.rows, *self._row_shape)
        header = {
            "descr": np.lib.format.dtype_to_descr(self._dtype),
            "fortran_order": False,
            "shape": shape,
        }
        np.lib.format.write_array_header_1_0(
            self.file, header
        )  # padded, so that the count may grow in place


def _flush(file: IO[Any]) -> None:
    file.flush()
    os.fsync(file.fileno())


def _locked(folder: Path) -> IO[bytes]:
    """Makes a folder and takes it for this process; the system gives it back when the process ends.

    Raises:
        DatasetError: another process has it.
    """
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            lock = (folder / "lock").open("ab")
        except FileNotFoundError:
            continue  # it was finished and renamed in between
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise DatasetError(f"another process is writing {folder}: wait for it") from None
        return lock
