"""The packed layout of a dataset: a manifest beside a few arrays that hold all takes one after another.

==================  =======================================================================================
``manifest.json``   name, kind, ``fps``, named splits, unit and axes of the source, and the lists ``sequences``,
                    ``identities``, ``topologies`` and ``excluded`` (what was left out, and why)
``landmarks.npy``   (N, 68, 3) float32, displacements from neutral, m, of all frames
``motion.npy``      (N, V, 3) float16, vertex displacements, m; or (N, E) float32, factors: expression weights, or
                    FLAME's expression and the jaw's rotation matrix minus the identity; absent where only the
                    landmarks are known, and where frames are scans
``scans.npy``       (N, P, 3) float16, points of the surface of each frame, m; only where frames are meshes of their
                    own each (:mod:`freetalk.data.scans`)
``codes.npy``       (N, Z) float32, expression codes of a parametric head; only where they were fitted
                    (:mod:`freetalk.data.codes`)
``audio.npy``       (S,) int16 at 16 kHz, 32768 is full scale
``identities.npy``  (I, K) float32, coefficients of each face
``topologies/``     an ``.npz`` a meshing: ``neutral`` (V, 3), ``faces`` (F, 3), ``identity_basis`` (K, V, 3),
                    ``lip_mask``, ``upper_face_mask`` (V,); ``expression_basis`` (E, V, 3) for factors, with
                    ``jaw_weights``, ``jaw_regressor`` (V,) for FLAME's; ``landmarks`` (68,) vertices
``extras.npz``      ``landmark_basis`` (E, 68, 3) where drawn weights make faces, m
``phones.json``     phones of the sequences that have them: (start in s, end in s, ARPABET label)
==================  =======================================================================================

A folder with a manifest is complete; :mod:`freetalk.data.pack_writer` writes it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.errors import DatasetError, MissingFileError

FORMAT, VERSION = "freetalk-dataset", 1
SAMPLE_RATE_HZ = 16000
FULL_SCALE = 32768.0
#: Numbers that a rotation matrix minus the identity has.
_TURN = 9

FloatArray = npt.NDArray[np.float32]
Array = npt.NDArray[Any]


class Rows:
    """Rows of an ``.npy`` file, read when they are asked for; a mapped one would be read ahead by megabytes a window.

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

    def read(self, first: int, stop: int) -> Array:
        """Rows [first, stop)."""
        return read_rows(self.path, first, stop, self.dtype, self.shape[1:], self._offset)


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
        joint = (regressor @ (neutral + offset - corrective))[:, None]
        moved = (neutral + offset - joint) @ turn.swapaxes(1, 2)
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
        about = self.directory / "codes.json"
        content += about.read_bytes() if about.is_file() else b""
        self.fingerprint = hashlib.sha256(content).hexdigest()[:16]
        self.fps = float(self.manifest["fps"])
        self.expressions: tuple[str, ...] = tuple(self.manifest["expressions"])
        self.moves_all: bool = self.manifest["moves"] == "all"
        self.landmarks, self.audio = (
            Rows(self.directory / f"{name}.npy") for name in ("landmarks", "audio")
        )
        motion = self.directory / "motion.npy"
        self.motion = Rows(motion) if motion.is_file() else None
        codes, scans = self.directory / "codes.npy", self.directory / "scans.npy"
        self.codes = Rows(codes) if codes.is_file() else None
        self.scans = Rows(scans) if scans.is_file() else None
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
        for moved in (self.motion, self.scans):
            if moved is not None:
                arrays.append(moved.read(first, first + frames))
        arrays.append(
            self.audio.read(entry["first_sample"], entry["first_sample"] + entry["num_samples"])
        )
        return digest_of(arrays)

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
            (self.codes, frames),
            (self.scans, frames),
            (self.audio, samples),
        ):
            if rows is not None and rows.shape[0] < wanted:
                raise DatasetError(
                    f"{rows.path} has shape {rows.shape}, the manifest needs {wanted} rows: it is cut short, or "
                    "of another dataset"
                )


def read_rows(
    path: Path,
    first: int,
    stop: int,
    dtype: npt.DTypeLike,
    row_shape: tuple[int, ...],
    offset: int = 0,
) -> Array:
    """Rows [first, stop) of a file, and no more: a mapped window would be read ahead by megabytes.

    Args:
        path: the file.
        first: the first row.
        stop: the row after the last.
        dtype: of the numbers.
        row_shape: of a row.
        offset: bytes before the first row of the file.

    Raises:
        DatasetError: the file ends before.
    """
    found = np.empty((max(0, stop - first), *row_shape), dtype)
    left = found.reshape(-1).view(np.uint8).data
    with path.open("rb", buffering=0) as file:
        file.seek(offset + first * (found.nbytes // max(len(found), 1)))
        while left:
            count = file.readinto(left)
            if not count:
                raise DatasetError(f"{path} has no rows {first} to {stop}: it is cut short")
            left = left[count:]
    return found


def _arrays(path: Path) -> dict[str, Array]:
    """The arrays of an ``.npz``."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except FileNotFoundError:
        raise MissingFileError(f"{path} is missing: import the dataset anew") from None


def digest_of(arrays: list[Array]) -> str:
    """What the manifest's ``sha256`` of a sequence says of its arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:16]
