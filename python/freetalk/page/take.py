"""One performance as the page reads it: a header in JSON and little-endian arrays, compressed."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Sequence as Listing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from freetalk.animation import Animation, morph_basis
from freetalk.viz.appearance import seen_faces, vertex_colors
from freetalk.viz.cavities import find_cavities
from freetalk.viz.renderer import FACE_BOX
from freetalk.viz.sequence import Sequence, as_sequence

MAGIC = b"ftk1"
_PICTURES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
}

Phones = Listing[tuple[float, float, str]]


def pack_take(
    animation: Any,
    *,
    name: str = "",
    tolerance_mm: float = 0.1,
    curves: dict[str, NDArray[np.floating[Any]]] | None = None,
    phones: Phones = (),
    landmarks: NDArray[np.integer[Any]] | None = None,
    colors: NDArray[Any] | None = None,
    texture: str | Path | None = None,
    facts: dict[str, str] | None = None,
) -> bytes:
    """Packs an animation for the page.

    Args:
        animation: ``freetalk.Animation``, ``viz.Sequence`` or path of an animation ``.npz``.
        name: what the page calls it.
        tolerance_mm: largest error of a vertex in the page; what was reached is shown there.
        curves: (T,) weights in [0, 1] by ARKit's names.
        phones: (start, end, label) in seconds.
        landmarks: (68,) vertices to mark.
        colors: (V, 3) or (V, 4) uint8, or numbers in [0, 1]; by default those of skin, eyes and teeth.
        texture: PNG, JPEG or WebP; needs a mesh with texture coordinates.
        facts: what the page lists beside, by label.

    Returns:
        The take, gzipped: ``ftk1``, the header's length as uint32, the header, then arrays at multiples of 4.

    Raises:
        ValueError: shapes or lengths do not fit, or a texture without texture coordinates.
        OSError: the texture cannot be read.
    """
    if isinstance(animation, str | os.PathLike):
        animation = Animation.load(animation)
    sequence = as_sequence(animation)
    if not tolerance_mm > 0:
        raise ValueError(f"tolerance_mm must be above 0, found {tolerance_mm}")
    rest = sequence.upright(sequence.vertices)
    motion = pack_motion(sequence.displacements, sequence.upright_matrix[:3, :3], tolerance_mm)
    writer = _Writer()
    header = _begin(writer, sequence, rest, motion, name)
    header["phones"] = [[float(start), float(end), str(label)] for start, end, label in phones]
    header["facts"] = facts or {}
    if texture is not None:
        header["texture"] = _add_texture(writer, animation, sequence, Path(texture))
    else:
        writer.add("faces", seen_faces(rest, sequence.faces).astype(np.uint32))
    if colors is None:
        header["painted"] = False
        writer.add("colors", vertex_colors(rest, sequence.faces))
    else:
        header["painted"] = True
        writer.add("colors", _bytes_of_colors(colors, len(rest)))
    if len(sequence.samples):
        sound = np.rint(sequence.samples.clip(-1, 1) * 32767).astype(np.int16)
        writer.add("sound", sound)
        header["rate_hz"] = sequence.sample_rate_hz
    if landmarks is not None:
        writer.add("landmarks", _checked_landmarks(landmarks, len(rest)))
    if sequence.head is not None:
        poses = [sequence.head_at(t / sequence.fps).T for t in range(sequence.num_frames)]
        writer.add("head", np.stack(poses).astype(np.float32))  # columns first, as WebGL has them
    if curves:
        header["curves"] = list(curves)
        writer.add("curves", _checked_curves(curves, sequence.num_frames))
    if sequence.located:
        header |= _add_cavities(writer, rest, sequence.faces)
    return writer.bytes(header)


def pack_rig(
    still: Sequence, targets: NDArray[np.float32], names: Listing[str], name: str = ""
) -> bytes:
    """Packs a face that a live stream moves: one still frame, and the targets of its weights.

    Args:
        still: the resting face, aligned.
        targets: (W, V, 3) metres, upright: what each weight adds at one.
        names: of the weights; those of the correctives are not shown.
        name: what the page calls it.

    Returns:
        As :func:`pack_take`.
    """
    rest = still.upright(still.vertices)
    step_m = max(float(np.abs(targets).max(initial=0.0)) / 32767, 2e-6)
    packed = np.rint(targets / step_m).astype(np.int16)
    motion = PackedMotion(packed, np.zeros((1, len(packed)), np.uint16), step_m, 500 * step_m)
    writer = _Writer()
    header = _begin(writer, still, rest, motion, name)
    shapes = [shape for shape in names if not shape.startswith("corrective_")]
    header |= {"phones": [], "facts": {}, "painted": False, "live": shapes}
    writer.add("faces", seen_faces(rest, still.faces).astype(np.uint32))
    writer.add("colors", vertex_colors(rest, still.faces))
    return writer.bytes(header | _add_cavities(writer, rest, still.faces))


def _begin(
    writer: _Writer, sequence: Sequence, rest: NDArray[np.float32], motion: PackedMotion, name: str
) -> dict[str, Any]:
    """Writes the rest pose and the motion; returns what the header says of them."""
    writer.add("rest", rest)
    writer.add("targets", motion.targets)
    writer.add("weights", motion.weights)
    return {
        "name": name,
        "fps": sequence.fps,
        "frames": sequence.num_frames,
        "step_m": motion.step_m,
        "error_mm": motion.error_mm,
        "framing": _framing(rest, sequence.located),
    }


def read_take(packed: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and arrays of what :func:`pack_take` made.

    Raises:
        ValueError: other content.
    """
    content = gzip.decompress(packed)
    if content[:4] != MAGIC:
        raise ValueError("not a take of the page")
    length = int.from_bytes(content[4:8], "little")
    header: dict[str, Any] = json.loads(content[8 : 8 + length])
    arrays = {}
    for name, entry in header["arrays"].items():
        kind, first = np.dtype(entry["type"]), 8 + _padded(length) + entry["offset"]
        raw = np.frombuffer(content, np.uint8, int(np.prod(entry["shape"])) * kind.itemsize, first)
        planes = np.ascontiguousarray(raw.reshape(kind.itemsize, -1).T)
        arrays[name] = planes.reshape(-1).view(kind).reshape(entry["shape"])
    return header, arrays


class _Writer:
    """Arrays one after the other, each as planes of bytes: the first byte of every value, the second, ..."""

    def __init__(self) -> None:
        self._entries: dict[str, dict[str, Any]] = {}
        self._parts: list[bytes] = []
        self._length = 0

    def add(self, name: str, values: NDArray[Any]) -> None:
        values = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        planes = values.reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T.tobytes()
        self._entries[name] = {
            "type": values.dtype.name,
            "shape": list(values.shape),
            "offset": self._length,
        }
        self._parts.append(planes.ljust(_padded(len(planes)), b"\0"))
        self._length += len(self._parts[-1])

    def bytes(self, header: dict[str, Any]) -> bytes:
        text = json.dumps(header | {"arrays": self._entries}, separators=(",", ":")).encode()
        start = MAGIC + len(text).to_bytes(4, "little") + text.ljust(_padded(len(text)), b" ")
        return gzip.compress(b"".join([start, *self._parts]), compresslevel=6, mtime=0)


def _padded(length: int) -> int:
    return -(-length // 4) * 4


def _framing(rest: NDArray[np.float32], located: bool) -> dict[str, list[float]]:
    """What the camera looks at: the middle and the extent of the face."""
    low, high = rest.min(0), rest.max(0)
    if located:
        low, high = np.maximum(low, FACE_BOX[0]), np.minimum(high, FACE_BOX[1])
    return {
        "center": ((low + high) / 2).astype(float).tolist(),
        "extent": np.maximum(high - low, 1e-6).astype(float).tolist(),
    }


def _add_texture(
    writer: _Writer, animation: Any, sequence: Sequence, texture: Path
) -> dict[str, str]:
    """Faces whose corners have a texture coordinate each, and the picture.

    A vertex on a seam of the texture is drawn once for each of its coordinates; ``corners`` says whose motion each
    drawn vertex follows.
    """
    kind = _PICTURES.get(texture.suffix.lower())
    if kind is None:
        raise ValueError(f"'{texture}' is no texture: give a PNG, JPEG or WebP file")
    mesh = getattr(animation, "mesh", None)
    coordinates = None if mesh is None else corner_texcoords(mesh)
    if mesh is None or coordinates is None:
        raise ValueError(f"the mesh has no texture coordinates for '{texture.name}'")
    pairs = np.stack([sequence.faces.reshape(-1), coordinates.reshape(-1)], axis=1)
    drawn, index = np.unique(pairs, axis=0, return_inverse=True)
    writer.add("faces", index.reshape(-1, 3).astype(np.uint32))
    writer.add("corners", drawn[:, 0].astype(np.uint32))
    writer.add("texcoords", np.asarray(mesh.texcoords, np.float32)[drawn[:, 1]])
    writer.add("texture", np.frombuffer(texture.read_bytes(), np.uint8))
    return {"type": kind}


def corner_texcoords(mesh: Any) -> NDArray[np.int64] | None:
    """(F, 3) rows of ``mesh.texcoords`` at the corners of its triangles; None where there are none."""
    if len(mesh.texcoords) == 0 or len(mesh.polygon_texcoords) == 0:
        return None
    polygons = mesh.polygons or mesh.faces.tolist()
    owner = mesh.face_polygon if len(mesh.face_polygon) else range(len(mesh.faces))
    rows = np.empty((len(mesh.faces), 3), np.int64)
    for number, (triangle, polygon) in enumerate(zip(mesh.faces.tolist(), owner)):
        at_vertex = dict(zip(polygons[polygon], mesh.polygon_texcoords[polygon]))
        rows[number] = [at_vertex[vertex] for vertex in triangle]
    return rows


def _bytes_of_colors(colors: NDArray[Any], count: int) -> NDArray[np.uint8]:
    values = np.asarray(colors)
    if values.ndim != 2 or len(values) != count or values.shape[1] not in (3, 4):
        raise ValueError(f"colors must be ({count}, 3) or ({count}, 4), found {values.shape}")
    if values.dtype != np.uint8:
        values = np.rint(values.clip(0, 1) * 255).astype(np.uint8)
    return np.ascontiguousarray(values[:, :3])


def _checked_landmarks(landmarks: NDArray[np.integer[Any]], count: int) -> NDArray[np.uint32]:
    indices = np.asarray(landmarks)
    if indices.ndim != 1 or (indices < 0).any() or (indices >= count).any():
        raise ValueError(f"landmarks must be vertices from 0 to {count - 1}")
    return indices.astype(np.uint32)


def _checked_curves(
    curves: dict[str, NDArray[np.floating[Any]]], num_frames: int
) -> NDArray[np.uint8]:
    """(C, T) uint8: the page draws them, it does not move the face with them."""
    values = np.stack([np.asarray(curve, np.float64) for curve in curves.values()])
    if values.shape[1:] != (num_frames,):
        raise ValueError(f"curves must be ({num_frames},) each, found {values.shape[1:]}")
    return np.rint(values.clip(0, 1) * 255).astype(np.uint8)


def _add_cavities(
    writer: _Writer, rest: NDArray[np.float32], faces: NDArray[np.int64]
) -> dict[str, Any]:
    """Stand-ins for open eyes and mouth."""
    found = find_cavities(rest, faces)
    header: dict[str, Any] = {
        "eyes": [{"center": eye.center.tolist(), "radius": float(eye.radius)} for eye in found.eyes]
    }
    if found.mouth is not None:
        writer.add("mouth_edges", found.mouth.edges.astype(np.uint32))
        header["mouth_depth"] = float(found.mouth.depth)
    return header


#: Of the error that is allowed, how much is left to the components that are cut off; steps take the rest.
_BASIS_SHARE = 0.8
_WEIGHT_STEPS = 65535
_STEP_LIMIT = 32767
_BLOCK = 16


@dataclass(frozen=True)
class PackedMotion:
    """Displacements as ``step_m * weights / 65535 @ targets``.

    Attributes:
        targets: (K, V, 3) int16.
        weights: (T, K) uint16.
        step_m: metres of a unit of ``targets``.
        error_mm: largest distance of a vertex from its true displacement over all frames, measured.
    """

    targets: NDArray[np.int16]
    weights: NDArray[np.uint16]
    step_m: float
    error_mm: float


def pack_motion(
    displacements: NDArray[np.float32], to_metres: NDArray[np.float64], tolerance_mm: float
) -> PackedMotion:
    """Packs displacements to within a tolerance.

    Args:
        displacements: (T, V, 3) in any unit and axes.
        to_metres: (3, 3) similarity without its shift, into upright metres.
        tolerance_mm: largest error of a vertex; motion of more than 512 components may miss it.

    Returns:
        The motion in upright metres; ``error_mm`` says what was reached.
    """
    unit_m = float(np.cbrt(abs(np.linalg.det(to_metres))))
    allowed_m = 1e-3 * tolerance_mm
    targets, weights, _ = morph_basis(
        torch.as_tensor(displacements),
        _BASIS_SHARE * allowed_m / unit_m,
        min(512, len(displacements) + 1),
    )
    turned = np.asarray(targets) @ to_metres.T.astype(np.float32)
    largest = float(np.abs(turned).max(initial=0.0))
    # Rounding errors of K components add up like those of a random walk.
    fine_m = (1 - _BASIS_SHARE) * allowed_m / np.sqrt(max(len(turned), 1))
    step_m = max(fine_m, largest / _STEP_LIMIT)
    packed = np.rint(turned / step_m).astype(np.int16)
    shares = np.rint(np.asarray(weights).clip(0, 1) * _WEIGHT_STEPS).astype(np.uint16)
    error_m = _largest_error(displacements, to_metres, packed, shares, step_m)
    return PackedMotion(packed, shares, step_m, 1e3 * error_m)


def unpack_motion(packed: PackedMotion) -> NDArray[np.float32]:
    """(T, V, 3) float32 displacements, upright metres, as the page shows them."""
    return _unpack(packed.targets, packed.weights, packed.step_m)


def _unpack(
    targets: NDArray[np.int16], weights: NDArray[np.uint16], step_m: float
) -> NDArray[np.float32]:
    scaled = weights.astype(np.float32) * np.float32(step_m / _WEIGHT_STEPS)
    flat = scaled @ targets.reshape(len(targets), 3 * targets.shape[1]).astype(np.float32)
    return flat.reshape(len(weights), *targets.shape[1:])


def _largest_error(
    displacements: NDArray[np.float32],
    to_metres: NDArray[np.float64],
    targets: NDArray[np.int16],
    weights: NDArray[np.uint16],
    step_m: float,
) -> float:
    largest = 0.0
    turn = to_metres.T.astype(np.float32)
    for first in range(0, len(weights), _BLOCK):
        block = slice(first, first + _BLOCK)
        off = _unpack(targets, weights[block], step_m) - displacements[block] @ turn
        largest = max(largest, float(np.einsum("tvc,tvc->tv", off, off).max()))
    return float(np.sqrt(largest))
