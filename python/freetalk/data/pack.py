"""The packed layout of a dataset: a manifest beside a few arrays that hold all takes one after another.

==================  =======================================================================================
``manifest.json``   name, kind, ``fps``, named splits, unit and axes of the source, and the lists ``sequences``,
                    ``identities``, ``topologies`` and ``excluded`` (what was left out, and why)
``landmarks.npy``   (N, 68, 3) float32, displacements from neutral, m, of all frames
``motion.npy``      (N, V, 3) float16, vertex displacements, m; or (N, E) float32, factors: expression weights, or
                    FLAME's expression and the jaw's rotation matrix minus the identity; absent where only the
                    landmarks are known
``audio.npy``       (S,) int16 at 16 kHz, 32768 is full scale
``identities.npy``  (I, K) float32, coefficients of each face
``topologies/``     an ``.npz`` a meshing: ``neutral`` (V, 3), ``faces`` (F, 3), ``identity_basis`` (K, V, 3),
                    ``lip_mask``, ``upper_face_mask`` (V,); ``expression_basis`` (E, V, 3) for factors, with
                    ``jaw_weights``, ``jaw_regressor`` (V,) for FLAME's; ``landmarks`` (68,) vertices
``extras.npz``      ``landmark_basis`` (E, 68, 3) where drawn weights make faces, m
``phones.json``     phones of the sequences that have them: (start in s, end in s, ARPABET label)
==================  =======================================================================================

A folder with a manifest is complete. :class:`PackWriter` works in a hidden folder beside it, takes note of what has
reached the disk, goes on there after a stop, and renames the folder when all is there.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from freetalk._files import flush, write_text
from freetalk.data.errors import DatasetError, MissingFileError, NotFiniteError
from freetalk.data.landmarks import NUM_LANDMARKS

FORMAT, VERSION = "freetalk-dataset", 1
#: What may be replaced: this one, and that of corpora before it.
_FORMATS = (FORMAT, "freetalk-open-corpus")
SAMPLE_RATE_HZ = 16000
FULL_SCALE = 32768.0
#: Numbers that a rotation matrix minus the identity has.
_TURN = 9
#: Appended bytes after which the journal is brought up to date.
_COMMIT_BYTES = 64 << 20
_COMMIT_TAKES = 256

FloatArray = npt.NDArray[np.float32]
Array = npt.NDArray[Any]


class Rows:
    """Rows of an ``.npy`` file, mapped for each read and never kept, so that memory stays that of the rows.

    Args:
        path: the file.

    Raises:
        MissingFileError, DatasetError: no such file; no array, or cut short.
    """

    def __init__(self, path: Path) -> None:
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except FileNotFoundError:
            raise MissingFileError(f"{path} is missing: import the dataset anew") from None
        except (ValueError, EOFError, OSError) as error:
            raise DatasetError(f"{path} is no readable array ({error})") from error
        self.path, self.shape, self.dtype = path, tuple(array.shape), array.dtype
        self._offset = int(getattr(array, "offset", 0))
        self._row_bytes = array.dtype.itemsize * int(np.prod(self.shape[1:], dtype=np.int64))

    def read(self, first: int, stop: int) -> Array:
        """Rows [first, stop), a copy."""
        if stop <= first:
            return np.zeros((0, *self.shape[1:]), self.dtype)
        mapped = np.memmap(
            self.path,
            self.dtype,
            "r",
            self._offset + first * self._row_bytes,
            (stop - first, *self.shape[1:]),
        )
        return np.array(mapped)


class Meshing:
    """The arrays of a meshing; what its factors do to its vertices.

    Args:
        arrays: as its ``.npz`` has them.
    """

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self.faces = arrays["faces"].astype(np.int64)
        self.lip_mask, self.upper_face_mask = (
            arrays[k].astype(bool) for k in ("lip_mask", "upper_face_mask")
        )
        self.landmarks: npt.NDArray[np.int64] | None = arrays.get("landmarks")
        self._neutral, self._modes = arrays["neutral"], arrays["identity_basis"].astype(np.float32)
        basis = arrays.get("expression_basis", np.zeros((0, *self._neutral.shape), np.float32))
        self.expression_basis: FloatArray = basis.astype(np.float32)
        self._jaw = (
            (arrays["jaw_weights"], arrays["jaw_regressor"]) if "jaw_weights" in arrays else None
        )

    def neutral(self, coefficients: FloatArray) -> FloatArray:
        """(V, 3) m: the neutral face of coefficients (K,)."""
        offset = np.tensordot(coefficients, self._modes[: len(coefficients)], axes=1)
        return np.asarray(self._neutral + offset, dtype=np.float32)

    def displacements(self, factors: FloatArray, neutral: FloatArray) -> FloatArray:
        """(T, V, 3) m: what factors (T, E) do to a neutral face (V, 3) [FLAME, Li et al. 2017, Eq. 1-3]."""
        flat = self.expression_basis.reshape(len(self.expression_basis), -1)
        offset: FloatArray = (factors @ flat).reshape(len(factors), -1, 3)
        if self._jaw is None:
            return offset
        weights, regressor = self._jaw
        turn = factors[:, -_TURN:].reshape(-1, 3, 3)
        corrective = (factors[:, -_TURN:] @ flat[-_TURN:]).reshape(offset.shape)
        joint = np.einsum("v,tvd->td", regressor, neutral + offset - corrective)[:, None]
        moved = np.einsum("tij,tvj->tvi", turn, neutral + offset - joint)
        return (offset + weights[:, None] * moved).astype(np.float32)


class Pack:
    """A packed folder, opened for reading.

    Args:
        directory: the folder.

    Raises:
        MissingFileError, DatasetError: no manifest, or a file that disagrees with it.
    """

    def __init__(self, directory: str | Path) -> None:
        self.directory = Path(directory).resolve()
        path = self.directory / "manifest.json"
        if not path.is_file():
            raise MissingFileError(f"{self.directory} holds no manifest.json")
        content = path.read_bytes()
        self.manifest: dict[str, Any] = json.loads(content)
        found = self.manifest.get("format"), self.manifest.get("version")
        if found != (FORMAT, VERSION):
            raise DatasetError(
                f"{path} is of format {found[0]} version {found[1]}, expected {FORMAT} version {VERSION}: make it "
                "anew with 'freetalk corpus build' or 'freetalk data import'"
            )
        self.fingerprint = hashlib.sha256(content).hexdigest()[:16]
        self.fps = float(self.manifest["fps"])
        self.expressions: tuple[str, ...] = tuple(self.manifest["expressions"])
        self.moves_all: bool = self.manifest["moves"] == "all"
        self.landmarks, self.audio = (
            Rows(self.directory / f"{name}.npy") for name in ("landmarks", "audio")
        )
        motion = self.directory / "motion.npy"
        self.motion = Rows(motion) if motion.is_file() else None
        self.identities = np.load(self.directory / "identities.npy")
        self._phones: dict[str, list[list[Any]]] | None = None
        # Bound per object, so that two packs never share a meshing of the same name.
        self.meshing = lru_cache(maxsize=16)(self._load_meshing)
        self._check_sizes()

    def __reduce__(self) -> tuple[type[Pack], tuple[Path]]:
        return Pack, (self.directory,)  # another process opens it anew

    def phones(self, name: str) -> list[tuple[float, float, str]]:
        """Phones of a sequence; empty where none are known."""
        if self._phones is None:
            path = self.directory / "phones.json"
            self._phones = json.loads(path.read_text()) if path.is_file() else {}
        return [(float(a), float(b), str(label)) for a, b, label in self._phones.get(name, [])]

    def extras(self) -> dict[str, Array]:
        """Arrays that not every dataset has."""
        path = self.directory / "extras.npz"
        return _arrays(path) if path.is_file() else {}

    def digest(self, entry: Mapping[str, Any]) -> str:
        """What the manifest's ``sha256`` of a sequence has to be, from the arrays."""
        first, frames = entry["start_frame"], entry["num_frames"]
        arrays = [self.landmarks.read(first, first + frames)]
        if self.motion is not None:
            arrays.append(self.motion.read(first, first + frames))
        arrays.append(
            self.audio.read(entry["first_sample"], entry["first_sample"] + entry["num_samples"])
        )
        return _digest(arrays)

    def _load_meshing(self, name: str) -> Meshing:
        for entry in self.manifest["topologies"]:
            if entry["name"] == name:
                return Meshing(_arrays(self.directory / entry["file"]))
        known = ", ".join(entry["name"] for entry in self.manifest["topologies"])
        raise ValueError(f"no topology {name!r} in {self.directory}; known: {known}")

    def _check_sizes(self) -> None:
        entries = self.manifest["sequences"]
        frames = max((e["start_frame"] + e["num_frames"] for e in entries), default=0)
        samples = max((e["first_sample"] + e["num_samples"] for e in entries), default=0)
        for rows, wanted in (
            (self.landmarks, frames),
            (self.motion, frames),
            (self.audio, samples),
        ):
            if rows is not None and rows.shape[0] < wanted:
                raise DatasetError(
                    f"{rows.path} has shape {rows.shape}, the manifest needs {wanted} rows: it is cut short, or "
                    "of another dataset"
                )


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
        sound: str = "",
        phones: list[Any] | None = None,
    ) -> None:
        """Appends a take.

        Args:
            entry: of the manifest, with ``id``; where its frames and samples lie is added.
            landmarks: (T, 68, 3) displacements, m.
            motion: (T, V, 3) displacements, m, or (T, E) factors.
            samples: (S,) at 16 kHz; empty where there is no sound, or where `sound` was given before.
            sound: takes of the same name share the first one's samples.
            phones: (start in s, end in s, label).

        Raises:
            NotFiniteError: a frame holds NaN or infinity.
        """
        arrays: dict[str, Array] = {"landmarks": np.asarray(landmarks, np.float32)}
        if motion is not None:
            arrays["motion"] = np.asarray(motion, np.float16 if motion.ndim == 3 else np.float32)
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
            "sha256": _digest(
                [*(arrays[n] for n in ("landmarks", "motion") if n in arrays), heard]
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
        arrays = [array.file for array in self._files.values()]
        for file in (*arrays, self._journal, self._lock):
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
        self.file.write(np.ascontiguousarray(array).tobytes())
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


def _arrays(path: Path) -> dict[str, Array]:
    """The arrays of an ``.npz``."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise MissingFileError(f"{path} is missing: import the dataset anew") from None


def _flush(file: IO[Any]) -> None:
    file.flush()
    os.fsync(file.fileno())


def _digest(arrays: list[Array]) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]


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
