"""Typed access to the data that ships with the package: faces, captured takes, expression curves, a clip.

Everything is returned in metres in the canonical frame: +Y up, +Z out of the face, +X the subject's left, origin at
the mean of the 68 landmarks of the mean face.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import soundfile as sf

Array = npt.NDArray[np.float32]
ASSETS = Path(__file__).resolve().parents[1] / "assets"

EXTENTS = {"narrow": 6706, "face": 9409, "head": 11248, "sockets": 14062, "full": 26719}
"""Number of leading vertices that each extent of the ICT-FaceKit mesh keeps."""

TRAIN_TAKES = ("1114_2_01", "1114_2_02", "1114_2_03", "1114_2_04", "1114_2_05")
TEST_TAKES = ("1114_3_15",)
SPEAKERS = {"train": ("03", "08", "11", "12", "13", "14"), "val": ("10",), "test": ("09",)}
"""Emo-DB speakers by split."""


@dataclass(frozen=True)
class FaceModel:
    """The linear face: vertices = neutral + identity · identity_basis + weights · expression_basis.

    Attributes:
        neutral: (V, 3) float32, m, canonical frame.
        quads: (F, 4) int32, -1 in the last column of a triangle.
        expression_basis: (E, V, 3) float32, m.
        expression_names: the E names (ICT-FaceKit's, ARKit's with _L and _R).
        identity_basis: (100, V', 3) float32, m; V' = 14,062 (teeth and eyes have none).
        landmarks68: (68,) int32 vertex indices, iBUG order.
    """

    neutral: Array
    quads: npt.NDArray[np.int32]
    expression_basis: Array
    expression_names: tuple[str, ...]
    identity_basis: Array
    landmarks68: npt.NDArray[np.int32]

    @property
    def landmark_basis(self) -> Array:
        """(E, 68, 3) float32, m: landmark displacements of each expression at weight one."""
        return self.expression_basis[:, self.landmarks68]

    def index(self, name: str) -> int:
        """Column of an expression by name."""
        return self.expression_names.index(name)


@dataclass(frozen=True)
class Take:
    """One captured take: audio (S,) float32 at 16 kHz and named curves (T, C) in [0, 1] at `fps`."""

    name: str
    audio: Array
    sample_rate_hz: int
    curves: Array
    curve_names: tuple[str, ...]
    fps: float


@dataclass(frozen=True)
class Clip:
    """A clip of acted emotional German speech: audio (S,) float32 at 16 kHz, (end in seconds, label) phones."""

    name: str
    speaker: str
    emotion: str
    text: str
    audio: Array
    phones: tuple[tuple[float, str], ...]


def unpack_deltas(packed: npt.NDArray[np.uint8], step: float) -> Array:
    """Undoes the packing of `scripts/pack_assets.py`: (2, K, 3, V) bytes to (K, V, 3) deltas."""
    zigzag = packed[0].astype(np.int32) | (packed[1].astype(np.int32) << 8)
    steps = np.cumsum((zigzag >> 1) ^ -(zigzag & 1), axis=-1, dtype=np.int32)
    return np.ascontiguousarray(steps.transpose(0, 2, 1) * np.float32(step), dtype=np.float32)


@lru_cache(maxsize=1)
def load_face_model() -> FaceModel:
    """Loads ICT-FaceKit (MIT) in metres in the canonical frame; the result is cached and read-only."""
    with np.load(ASSETS / "ict_facekit" / "faces.npz") as data:
        step_m = float(data["step_cm"]) * 0.01
        landmarks = data["landmarks68"].astype(np.int32)
        neutral = data["neutral_cm"].astype(np.float64) * 0.01
        neutral -= neutral[landmarks].mean(axis=0)
        quads = data["quads"].astype(np.int32)
        quads[quads == 0xFFFF] = -1
        model = FaceModel(
            neutral=neutral.astype(np.float32),
            quads=quads,
            expression_basis=unpack_deltas(data["expression"], step_m),
            expression_names=tuple(str(name) for name in data["expression_names"]),
            identity_basis=unpack_deltas(data["identity"], step_m),
            landmarks68=landmarks,
        )
    for field in ("neutral", "quads", "expression_basis", "identity_basis", "landmarks68"):
        getattr(model, field).setflags(write=False)
    return model


def triangulate(
    quads: npt.NDArray[np.int32], other_diagonal: bool = False
) -> npt.NDArray[np.int32]:
    """Splits quads (F, 4), -1 last in triangles, along 0-2 or, with `other_diagonal`, along 1-3."""
    is_quad = quads[:, 3] >= 0
    a, b, c, d = quads[is_quad].T
    if other_diagonal:
        halves = np.stack([np.stack([a, b, d], 1), np.stack([b, c, d], 1)], 1)
    else:
        halves = np.stack([np.stack([a, b, c], 1), np.stack([a, c, d], 1)], 1)
    return np.concatenate([halves.reshape(-1, 3), quads[~is_quad][:, :3]]).astype(np.int32)


def crop_quads(model: FaceModel, extent: str) -> npt.NDArray[np.int32]:
    """Polygons whose vertices all lie in an extent of `EXTENTS`."""
    if extent not in EXTENTS:
        raise ValueError(f"extent is {extent!r}: use one of {', '.join(EXTENTS)}")
    return model.quads[model.quads.max(axis=1) < EXTENTS[extent]]


def mean_face(extent: str = "face") -> tuple[Array, npt.NDArray[np.int32]]:
    """The mean face as a mesh for demos.

    Args:
        extent: "narrow", "face", "head" (with neck), "sockets" (with mouth and eye sockets) or "full" (with
            teeth, tongue, eyeballs and lashes).

    Returns:
        vertices (V, 3) float32 in metres in the canonical frame and triangles (F, 3) int32.
    """
    model = load_face_model()
    faces = triangulate(crop_quads(model, extent))
    return model.neutral[: EXTENTS[extent]].copy(), faces


def load_take(name: str) -> Take:
    """Loads one FACEGOOD take (MIT) by name: one of `TRAIN_TAKES` or `TEST_TAKES`."""
    if name not in TRAIN_TAKES + TEST_TAKES:
        raise ValueError(f"take is {name!r}: use one of {', '.join(TRAIN_TAKES + TEST_TAKES)}")
    folder = ASSETS / "facegood_audio2face"
    audio, rate = sf.read(folder / f"{name}.flac", dtype="float32")
    with np.load(folder / f"{name}.npz") as data:
        return Take(
            name=name,
            audio=audio,
            sample_rate_hz=int(rate),
            curves=data["weights"].astype(np.float32) / np.float32(65535),
            curve_names=tuple(str(n) for n in data["names"]),
            fps=float(data["fps"]),
        )


def load_arkit_map() -> dict[str, list[str]]:
    """ARKit name -> FACEGOOD curves of which to take the maximum (FACEGOOD's own table)."""
    table = json.loads((ASSETS / "facegood_audio2face" / "arkit_map.json").read_text())
    return {name: list(entry["max_of"]) for name, entry in table.items()}


def load_expression_take() -> tuple[Array, tuple[str, ...], float]:
    """A captured range-of-motion take (MIT): (T, 52) ARKit weights, their names, frames per second."""
    with np.load(ASSETS / "livelinkface_rom" / "rom.npz") as data:
        names = tuple(str(n) for n in data["names"])
        return data["weights"].astype(np.float32) / np.float32(65535), names, float(data["fps"])


@lru_cache(maxsize=1)
def load_clips() -> tuple[Clip, ...]:
    """Clips of the Berlin Database of Emotional Speech (CC0) with narrow phone labels; eight speakers."""
    folder = ASSETS / "emodb"
    index = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    audio = {
        speaker: sf.read(folder / f"{speaker}.flac", dtype="float32")[0]
        for speaker in sorted({entry["speaker"] for entry in index})
    }
    return tuple(
        Clip(
            name=entry["clip"],
            speaker=entry["speaker"],
            emotion=entry["emotion"],
            text=entry["text"],
            audio=audio[entry["speaker"]][entry["start"] : entry["start"] + entry["samples"]],
            phones=tuple((float(end), str(label)) for end, label in entry["phones"]),
        )
        for entry in index
    )


def speech_clip() -> Path:
    """Path of a real English speech clip (public domain, 11 s, 16 kHz FLAC) for demos."""
    return ASSETS / "speech_english" / "jfk.flac"
