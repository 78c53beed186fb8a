"""Motion as the systems of this field write it: one ``.npy`` or ``.npz`` a sequence."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from freetalk.data import DatasetError, NotFiniteError
from freetalk.data.pose import UNITS

FloatArray = npt.NDArray[np.float32]

Phones = list[tuple[float, float, str]]


class Origin(NamedTuple):
    """Where a sequence comes from; sequences of one take are no independent observations.

    Attributes:
        speaker: empty where it is not known.
        take: unique among the speaker's.
    """

    speaker: str
    take: str


SUFFIXES = (".npy", ".npz")
#: Names of the motion in an ``.npz``, and whether it is displacements.
_KEYS = {"displacements": True, "vertices": False, "verts": False, "prediction": None, "pred": None}


@dataclass(frozen=True)
class Stated:
    """What a file says of its numbers; ``None`` where it says nothing.

    Attributes:
        metres_per_unit: its unit.
        fps: frames per second.
        up: (3,) its axis to the top of the head.
    """

    metres_per_unit: float | None = None
    fps: float | None = None
    up: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class MotionFile:
    """The content of a file.

    Attributes:
        path: the file.
        frames: (T, V, 3) float, the file's unit.
        is_displacement: where the file says so.
        stated: what else it says.
    """

    path: Path
    frames: FloatArray
    is_displacement: bool | None = None
    stated: Stated = Stated()

    def scale(self, given: float | None, option: str) -> float:
        """Metres per unit: the file's own, else what the user gave.

        Raises:
            ValueError: neither says it, or they differ.
        """
        found = agreed(self.stated.metres_per_unit, given, f"{self.path}: metres per unit", option)
        if found is None:
            raise ValueError(
                f"{self.path} states no unit: give {option} (m, cm, mm, in, or metres per unit)"
            )
        return found

    def check_fits(self, fps: float | None, up: tuple[float, float, float] | None) -> None:
        """Makes sure that the file has the ground truth's frame rate and axes.

        Raises:
            ValueError: it has not, or the ground truth's rate is not known.
        """
        own = self.stated
        if own.fps is not None and fps is None:
            raise ValueError(
                f"{self.path} has {own.fps:g} fps, the ground truth states none: give --fps"
            )
        if own.fps is not None and fps is not None and not math.isclose(own.fps, fps, rel_tol=1e-6):
            raise ValueError(
                f"{self.path} has {own.fps:g} fps, the ground truth {fps:g}: bring them to one rate"
            )
        if own.up is not None and up is not None and not np.allclose(own.up, up, atol=1e-6):
            raise ValueError(
                f"{self.path} has another axis to the top of the head, {own.up}, than the ground truth, {up}"
            )


def agreed(found: float | None, given: float | None, what: str, option: str) -> float | None:
    """What a file says, else what the user gave.

    Raises:
        ValueError: they differ.
    """
    if found is None or given is None:
        return given if found is None else found
    if not math.isclose(found, given, rel_tol=1e-6):
        raise ValueError(f"{what} {found:g}, but {option} says {given:g}")
    return found


def motion_paths(directory: Path) -> list[Path]:
    """The motion files of a folder, sorted."""
    if not directory.is_dir():
        raise FileNotFoundError(f"{directory} is no folder")
    return sorted(path for path in directory.iterdir() if path.suffix.lower() in SUFFIXES)


def read_motion(path: Path, num_vertices: int | None = None) -> MotionFile:
    """Reads (T, V, 3) or (T, V * 3), also with a batch of one in front.

    Args:
        path: ``.npy``, or ``.npz`` with one array, or one called displacements, vertices, verts,
            prediction or pred (as ``freetalk animate`` writes).
        num_vertices: V, where it is known.

    Raises:
        DatasetError: another shape or type, or no such array; not finite, with the frame.
    """
    is_displacement: bool | None = None
    stated = Stated()
    if path.suffix.lower() == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            key = next((name for name in _KEYS if name in archive.files), None)
            if key is None and len(archive.files) != 1:
                known = ", ".join(_KEYS)
                raise DatasetError(f"{path} holds {archive.files}; expected one of {known}")
            key = key or archive.files[0]
            array = archive[key]
            is_displacement = _KEYS.get(key)
            stated = _stated(archive, path)
    else:
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            raise DatasetError(f"{path} is no plain array: {error}") from error
    frames = _frames(array, path, num_vertices)
    finite = np.isfinite(frames).all(axis=(1, 2))
    if not finite.all():
        raise NotFiniteError(
            f"{path}: frame {int(np.flatnonzero(~finite)[0])} holds NaN or infinity"
        )
    return MotionFile(path, frames, is_displacement, stated)


def read_stated(path: Path) -> Stated:
    """What a file says of its numbers, without reading its motion."""
    if path.suffix.lower() != ".npz":
        return Stated()
    with np.load(path, allow_pickle=False) as archive:
        return _stated(archive, path)


def _stated(archive: Any, path: Path) -> Stated:
    def number(name: str) -> float | None:
        if name not in archive.files:
            return None
        value = np.asarray(archive[name], dtype=np.float64)
        if value.size != 1 or not (np.isfinite(value).all() and value.item() > 0):
            raise DatasetError(f"{path}: {name} is {value}, expected one number above 0")
        return float(value.item())

    up = None
    if "to_y_up" in archive.files:
        x, y, z = np.asarray(archive["to_y_up"], dtype=np.float64).reshape(3, 3)[1].tolist()
        up = (x, y, z)
    return Stated(number("metres_per_unit"), number("fps"), up)


def _frames(array: npt.NDArray[Any], path: Path, num_vertices: int | None) -> FloatArray:
    found = f"{path} is {array.dtype} {array.shape}"
    if array.dtype.kind != "f":
        raise DatasetError(f"{found}; expected floating point")
    if array.ndim == 4 or (array.ndim == 3 and array.shape[2] != 3):  # a batch in front
        if array.shape[0] != 1:
            raise DatasetError(f"{found}; expected one sequence, (T, V, 3) or (T, V * 3)")
        array = array[0]
    if array.ndim == 2 and array.shape[1] > 3 and array.shape[1] % 3 == 0:
        array = array.reshape(len(array), -1, 3)
    if array.ndim != 3 or array.shape[2] != 3 or array.size == 0:
        raise DatasetError(f"{found}; expected (T, V, 3) or (T, V * 3)")
    if num_vertices is not None and array.shape[1] != num_vertices:
        raise DatasetError(
            f"{found}: {array.shape[1]} vertices, the ground truth has {num_vertices}"
        )
    return np.array(array, dtype=np.float32)


def unit_scale(text: str) -> float:
    """Metres per unit: m, cm, mm, in, or a number."""
    if text in UNITS:
        return UNITS[text]
    try:
        scale = float(text)
    except ValueError:
        scale = 0.0
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError(f"unknown unit {text!r}: give m, cm, mm, in, or metres per unit")
    return scale


def guess_kind(frame: FloatArray, neutral: FloatArray | None, scale: float, where: str) -> str:
    """``vertices`` or ``displacements``: nearer to the neutral face or to zero; else by size.

    Args:
        frame: (V, 3), the file's unit.
        neutral: (V, 3) m.
        scale: metres per unit.
        where: what messages call it.
    """
    metres = frame * np.float32(scale)
    if neutral is not None:
        is_face = np.square(metres - neutral).sum() < np.square(metres).sum()
        return "vertices" if is_face else "displacements"
    extent = float(np.linalg.norm(metres.max(axis=0) - metres.min(axis=0)))
    if 0.05 < extent < 0.08:
        raise ValueError(
            f"{where}: vertices or displacements? Say so with --kind, or give --templates"
        )
    return "vertices" if extent >= 0.08 else "displacements"


class NameMatcher:
    """Finds the sequence that a prediction's file name belongs to.

    Args:
        names: sequences of the ground truth.
        pattern: such as ``faceformer_{name}_condition_{sample}``. Without one: the name itself;
            ``NAME_condition_STYLE`` (FaceFormer, CodeTalker, FaceDiffuser: the styles are samples);
            ``NAME_3`` and ``NAME_sample3``.
    """

    _PATTERNS = (
        "{name}",
        "{name}_condition_{sample}",
        "{name}_sample{number}",
        "{name}_{number}",
    )

    def __init__(self, names: Collection[str], pattern: str | None = None) -> None:
        if pattern is not None and "{name}" not in pattern:
            raise ValueError(f"the pattern {pattern!r} lacks {{name}}")
        self._names = frozenset(names)
        self._patterns = [_regex(text) for text in ([pattern] if pattern else self._PATTERNS)]

    def match(self, stem: str) -> str | None:
        """The sequence, or ``None``."""
        for pattern in self._patterns:
            found = pattern.fullmatch(stem)
            if found and found["name"] in self._names:
                return found["name"]
        return None

    def group(self, paths: Iterable[Path]) -> tuple[dict[str, list[Path]], list[Path]]:
        """Files by sequence, and those that belong to none."""
        groups: dict[str, list[Path]] = {}
        strangers = []
        for path in paths:
            name = self.match(path.stem)
            if name is None:
                strangers.append(path)
            else:
                groups.setdefault(name, []).append(path)
        return groups, strangers


def _regex(pattern: str) -> re.Pattern[str]:
    text = re.escape(pattern)
    for field, form in (("name", ".+"), ("sample", ".+"), ("number", r"\d+")):
        text = text.replace(re.escape(f"{{{field}}}"), f"(?P<{field}>{form})")
    return re.compile(text)
