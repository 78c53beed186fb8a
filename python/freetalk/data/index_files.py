"""Lists of vertices as research code stores them: ``.npy``, ``.txt``, ``.json``, ``.mat``, ``.pkl``."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.errors import DatasetError, VertexCountError
from freetalk.data.landmarks import NUM_LANDMARKS
from freetalk.data.pack import FloatArray
from freetalk.data.safe_pickle import load_pickle, read_pickle

IndexArray = npt.NDArray[np.int64]
SUFFIXES = (".json", ".txt", ".npy", ".npz", ".mat", ".pkl")
#: File of FLAME's jaw line, and rows of the embedding that it completes.
CONTOUR = "flame_dynamic_embedding.npy"
_STATIC = 51
_HASH_DIGITS = 16


def index_hash(indices: npt.NDArray[Any]) -> str:
    """The first 16 hex digits of the SHA-256 of little-endian 64-bit integers, row by row.

    The order counts: masks are hashed sorted and without repetition, landmarks as they are, faces as
    the mesh file has them.
    """
    data = np.ascontiguousarray(indices, dtype="<i8").tobytes()
    return hashlib.sha256(data).hexdigest()[:_HASH_DIGITS]


@dataclass(frozen=True)
class Landmarks:
    """The 68 points of a template, each a weighted mean of up to three vertices.

    Attributes:
        vertices: (68, 3) int64; three times the same where a landmark is a vertex.
        weights: (68, 3) float32, sum 1.
        source: file that says so.
    """

    vertices: IndexArray
    weights: FloatArray
    source: str

    def of(self, points: FloatArray) -> FloatArray:
        """Landmarks (..., 68, 3) of vertices (..., V, 3)."""
        corners = points[..., self.vertices, :]  # (..., 68, 3, 3)
        return np.einsum("...kcd,kc->...kd", corners, self.weights).astype(np.float32)

    @property
    def indices(self) -> IndexArray:
        """(68,) the vertex that counts most in each landmark."""
        rows = np.arange(len(self.vertices))
        return self.vertices[rows, self.weights.argmax(axis=1)]

    def describe(self) -> dict[str, Any]:
        """File, count and hash, as results name them."""
        exact = bool((self.vertices == self.vertices[:, :1]).all())
        key = self.indices if exact else np.rint(self.weights * 1e6)
        both = np.concatenate([self.vertices.ravel(), np.asarray(key).ravel()])
        found = index_hash(self.indices if exact else both)
        return {"source": self.source, "count": len(self.vertices), "sha256": found}


@dataclass(frozen=True)
class Mask:
    """A set of vertices, such as the lips.

    Attributes:
        indices: (N,) int64, rising.
        source: file that says so.
    """

    indices: IndexArray
    source: str

    def flags(self, num_vertices: int) -> npt.NDArray[np.bool_]:
        """(V,) bool."""
        flags = np.zeros(num_vertices, dtype=bool)
        flags[self.indices] = True
        return flags

    def describe(self) -> dict[str, Any]:
        """File, count and hash, as results name them."""
        found = index_hash(self.indices)
        return {"source": self.source, "count": len(self.indices), "sha256": found}


def read_mask(path: Path, num_vertices: int, parts: tuple[str, ...] = ()) -> Mask:
    """A mask of indices or of flags.

    Args:
        path: the file; a ``.mat`` counts from 1, as MATLAB does.
        num_vertices: V of the template.
        parts: keys of a file with several regions (``FLAME_masks.pkl``) to be united.

    Raises:
        DatasetError: not readable, empty, or no such part.
        VertexCountError: an index beyond the template's vertices.
    """
    content = _content(path)
    if isinstance(content, dict):
        regions = [content[part] for part in parts if part in content]
        if not regions:
            names = ", ".join(map(str, content))
            raise DatasetError(f"{path} has the regions {names}; needed is one of {parts}")
        values = np.concatenate([np.asarray(region).ravel() for region in regions])
    else:
        values = np.asarray(content).ravel()
    if values.dtype == bool and len(values) == num_vertices:
        values = np.flatnonzero(values)
    indices = np.unique(_integers(values, path))
    _check_range(indices, num_vertices, path)
    if len(indices) == 0:
        raise DatasetError(f"{path} names no vertex")
    return Mask(indices, str(path))


def read_landmarks(path: Path, faces: npt.NDArray[Any], num_vertices: int) -> Landmarks:
    """The 68 landmarks: vertex indices in iBUG order, or points on faces as FLAME's embeddings.

    Understood are 68 indices, a mapping with ``landmarks`` (``freetalk mesh landmarks`` also writes the
    ``corners`` and ``weights`` of each, which then count),
    one with ``lmk_face_idx`` and ``lmk_b_coords`` of 68 rows or with the ``full_lmk_faces_idx`` and
    ``full_lmk_bary_coords`` of DECA, and FLAME's ``flame_static_embedding.pkl`` (51 rows) beside its
    ``flame_dynamic_embedding.npy``, whose contour at angle 0 gives the 17 of the jaw.

    Raises:
        DatasetError: not readable, or other than 68 landmarks.
        VertexCountError: an index beyond the template's.
    """
    content = _content(path)
    if isinstance(content, dict):
        for face_key, weight_key in (
            ("lmk_face_idx", "lmk_b_coords"),
            ("full_lmk_faces_idx", "full_lmk_bary_coords"),
        ):
            if face_key in content and weight_key in content:
                rows, weights = (
                    np.ravel(content[face_key]),
                    np.reshape(content[weight_key], (-1, 3)),
                )
                if len(rows) == _STATIC:
                    jaw_rows, jaw_weights = _contour(path.with_name(CONTOUR))
                    rows = np.concatenate([jaw_rows, rows])
                    weights = np.concatenate([jaw_weights, weights])
                return _embedded(rows, weights, faces, path)
        if "landmarks" not in content:
            raise DatasetError(
                f"{path} names no landmarks; it holds {', '.join(map(str, content))}"
            )
        if int(content.get("vertices", num_vertices)) != num_vertices:
            raise VertexCountError(
                f"{path} is of a mesh with {content['vertices']} vertices, the template has "
                f"{num_vertices}"
            )
        if "corners" in content and "weights" in content:
            return _weighted(content["corners"], content["weights"], num_vertices, path)
        content = content["landmarks"]
    indices = _integers(np.asarray(content).ravel(), path)
    _check_count(len(indices), path)
    _check_range(indices, num_vertices, path)
    weights = np.zeros((NUM_LANDMARKS, 3), dtype=np.float32)
    weights[:, 0] = 1
    return Landmarks(np.repeat(indices[:, None], 3, axis=1), weights, str(path))


def _contour(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Faces (17,) and weights (17, 3) of FLAME's jaw line seen from the front."""
    if not path.is_file():
        raise DatasetError(
            f"{path} is missing: it holds the 17 landmarks of the jaw that {path.parent} lacks"
        )
    content = _npy(path)
    keys = ("lmk_face_idx", "lmk_b_coords")
    if not isinstance(content, dict) or any(key not in content for key in keys):
        raise DatasetError(f"{path} holds no {' and '.join(keys)}")
    return np.ravel(content[keys[0]][0]), np.reshape(content[keys[1]][0], (-1, 3))


def _embedded(face_rows: Any, weights: Any, faces: npt.NDArray[Any], path: Path) -> Landmarks:
    rows = _integers(np.asarray(face_rows).ravel(), path)
    _check_count(len(rows), path)
    _check_range(rows, len(faces), path, "faces")
    shares = np.asarray(weights, dtype=np.float32).reshape(-1, 3)
    if len(shares) != len(rows) or np.abs(shares.sum(axis=1) - 1).max() > 1e-3:
        raise DatasetError(
            f"{path}: {shares.shape} barycentric weights do not fit {len(rows)} faces"
        )
    return Landmarks(np.asarray(faces, dtype=np.int64)[rows], shares, str(path))


def _weighted(corners: Any, weights: Any, num_vertices: int, path: Path) -> Landmarks:
    vertices = _integers(np.asarray(corners).ravel(), path).reshape(-1, 3)
    _check_count(len(vertices), path)
    _check_range(vertices.ravel(), num_vertices, path)
    shares = np.asarray(weights, dtype=np.float32)
    if shares.shape != vertices.shape or np.abs(shares.sum(axis=1) - 1).max() > 1e-3:
        raise DatasetError(f"{path}: {shares.shape} weights do not fit {len(vertices)} landmarks")
    return Landmarks(vertices, shares, str(path))


def _content(path: Path) -> Any:
    """What a file holds: an array, a list or a mapping."""
    if path.suffix.lower() == ".json":
        return json.loads(path.read_text())
    if path.suffix.lower() == ".txt":
        text = re.sub(r"#[^\n]*", " ", path.read_text())
        try:
            return np.array([int(word) for word in re.split(r"[\s,;]+", text) if word])
        except ValueError as error:
            raise DatasetError(f"{path} is no list of whole numbers: {error}") from error
    if path.suffix.lower() == ".pkl":
        return load_pickle(path)
    if path.suffix.lower() == ".mat":
        from scipy.io import loadmat  # only these files need SciPy

        arrays = [v for k, v in loadmat(path).items() if not k.startswith("__")]
        if len(arrays) != 1:
            raise DatasetError(f"{path} holds {len(arrays)} arrays; expected one of indices")
        return _integers(np.asarray(arrays[0]).ravel(), path) - 1
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            names = archive.files
            return archive[names[0]] if len(names) == 1 else {name: archive[name] for name in names}
    return _npy(path)


def _npy(path: Path) -> Any:
    """A ``.npy``; one that holds a pickled object is read by the restricted unpickler."""
    with path.open("rb") as file:
        version = np.lib.format.read_magic(file)
        reads = "read_array_header_1_0" if version == (1, 0) else "read_array_header_2_0"
        if not getattr(np.lib.format, reads)(file)[2].hasobject:
            return np.load(path, allow_pickle=False)
        held = read_pickle(file, str(path))
    return held.item() if isinstance(held, np.ndarray) and held.shape == () else held


def _integers(values: npt.NDArray[Any], path: Path) -> IndexArray:
    whole = np.asarray(values)
    if whole.dtype.kind not in "iuf" or not np.array_equal(whole, np.floor(whole)):
        raise DatasetError(f"{path} holds {whole.dtype} values; expected whole numbers")
    return whole.astype(np.int64)


def _check_count(count: int, path: Path) -> None:
    if count != NUM_LANDMARKS:
        raise DatasetError(
            f"{path} names {count} landmarks; expected {NUM_LANDMARKS} in iBUG order "
            "(17 jaw, 10 brows, 9 nose, 12 eyes, 20 lips)"
        )


def _check_range(indices: IndexArray, limit: int, path: Path, what: str = "vertices") -> None:
    if len(indices) and not 0 <= indices.min() <= indices.max() < limit:
        raise VertexCountError(
            f"{path} names {what} from {indices.min()} to {indices.max()}, the template has {limit}; "
            "the file belongs to another mesh, or counts from 1"
        )
