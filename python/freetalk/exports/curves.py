"""ARKit's weights over time as files: CSV as Live Link Face writes it, JSON as Audio2Face writes it, NumPy.

Unreal's Live Link Face importer and Faceit read the CSV: a time code HH:MM:SS:FF.mmm, the number of values, ARKit's
52 shapes in the order of the app's files (jawRight before jawLeft, mouthRight before mouthLeft; the wire has them the
other way round), then nine rotations. These stay zero, the head's too: programs disagree on their unit and signs.
"""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from freetalk._files import replacing, write_text
from freetalk.exports.expression import arkit_curves, find_landmarks, landmark_curves
from freetalk.viz.sequence import as_sequence

if TYPE_CHECKING:
    from freetalk.animation import Animation

Curves = Mapping[str, NDArray[np.floating[Any]]]

_SIDES = ("Left", "Right")
_EYE = ("EyeBlink", "EyeLookDown", "EyeLookIn", "EyeLookOut", "EyeLookUp", "EyeSquint", "EyeWide")
_MOUTH_PAIRS = ("MouthSmile", "MouthFrown", "MouthDimple", "MouthStretch")
_LIP_PAIRS = ("MouthPress", "MouthLowerDown", "MouthUpperUp")
CSV_NAMES: tuple[str, ...] = (
    *(name + side for side in _SIDES for name in _EYE),
    *("JawForward", "JawRight", "JawLeft", "JawOpen"),
    *("MouthClose", "MouthFunnel", "MouthPucker", "MouthRight", "MouthLeft"),
    *(name + side for name in _MOUTH_PAIRS for side in _SIDES),
    *("MouthRollLower", "MouthRollUpper", "MouthShrugLower", "MouthShrugUpper"),
    *(name + side for name in _LIP_PAIRS for side in _SIDES),
    *("BrowDownLeft", "BrowDownRight", "BrowInnerUp", "BrowOuterUpLeft", "BrowOuterUpRight"),
    *("CheekPuff", "CheekSquintLeft", "CheekSquintRight", "NoseSneerLeft", "NoseSneerRight"),
    "TongueOut",
)
"""ARKit's shapes in the order of Live Link Face's files."""
_ROTATIONS = tuple(
    part + turn for part in ("Head", "LeftEye", "RightEye") for turn in ("Yaw", "Pitch", "Roll")
)


def arkit_weights(animation: Animation) -> dict[str, NDArray[np.float32]]:
    """ARKit's weights of an animation, from the landmarks that it was made of, else from those found on its mesh.

    Returns:
        (T,) float32 in [0, 1] by name.

    Raises:
        ValueError: no landmarks are known or found, or no weights with poses are installed.
    """
    curves: dict[str, NDArray[Any]] = {}
    if animation.landmarks is not None:
        curves = landmark_curves(animation.landmarks)
    else:
        sequence = as_sequence(animation)
        marks = find_landmarks(sequence)
        if marks is not None:
            curves = arkit_curves(sequence, marks)
    if not curves:
        raise ValueError(
            "ARKit's weights need the landmarks of the face: the animation holds none, and none were found on its mesh"
        )
    return curves


def save_curves(
    curves: Animation | Curves, path: str | os.PathLike[str], *, fps: float | None = None
) -> None:
    """Writes ARKit's weights by extension, atomically.

    Args:
        curves: an animation, or (T,) weights in [0, 1] by ARKit's names.
        path: ``.csv`` (Live Link Face), ``.json`` (Audio2Face) or ``.npz`` (``names``, ``weights`` (T, K), ``fps``).
        fps: frames per second; that of the animation.

    Raises:
        ValueError: another extension, curves of different lengths, or as :func:`arkit_weights`.
    """
    if not isinstance(curves, Mapping):
        fps = curves.fps if fps is None else fps
        curves = arkit_weights(curves)
    rate = 30.0 if fps is None else float(fps)
    target = Path(path)
    if len({len(curve) for curve in curves.values()}) != 1:
        raise ValueError("curves must be of one length")
    suffix = target.suffix.lower()
    if suffix == ".csv":
        write_text(target, _csv(curves, rate))
    elif suffix == ".json":
        write_text(target, _json(curves, rate))
    elif suffix == ".npz":
        weights = np.stack([np.asarray(curve, np.float32) for curve in curves.values()], axis=1)
        with replacing(target) as temporary, temporary.open("wb") as file:
            np.savez(file, names=np.array(list(curves)), weights=weights, fps=np.float64(rate))
    else:
        raise ValueError(f"'{path}': ARKit's weights are written as .csv, .json or .npz")


def load_curves(
    path: str | os.PathLike[str], *, fps: float | None = None
) -> tuple[dict[str, NDArray[np.float32]], float]:
    """Reads what :func:`save_curves` wrote, and takes of Live Link Face.

    Args:
        path: ``.csv``, ``.json`` or ``.npz``.
        fps: frames per second, in place of what the file says. A CSV says it only by how many frames its time codes
            count in a second: of a take in which no second ends it is 30, or 60 where more than 30 frames are counted.

    Returns:
        (T,) float32 by ARKit's names, rotations left out; and frames per second.

    Raises:
        ValueError: another extension or content.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    try:
        curves, own_fps = _read(file, suffix)
    except (KeyError, TypeError, IndexError, json.JSONDecodeError) as error:
        raise ValueError(f"'{path}' holds no ARKit weights: {error}") from error
    return curves, own_fps if fps is None else fps


def _read(file: Path, suffix: str) -> tuple[dict[str, NDArray[np.float32]], float]:
    if suffix == ".csv":
        return _parse_csv(file.read_text(encoding="utf-8"))
    if suffix == ".json":
        content = json.loads(file.read_text(encoding="utf-8"))
        weights = np.asarray(content["weightMat"], np.float32)
        return dict(zip(content["facsNames"], weights.T)), float(content["exportFps"])
    if suffix == ".npz":
        with np.load(file, allow_pickle=False) as data:
            columns = data["weights"].astype(np.float32).T
            return dict(zip(data["names"].tolist(), columns)), float(data["fps"])
    raise ValueError(f"'{file}' holds no ARKit weights: give .csv, .json or .npz")


def _csv(curves: Curves, fps: float) -> str:
    own = {name[0].upper() + name[1:]: np.asarray(curve) for name, curve in curves.items()}
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["Timecode", "BlendShapeCount", *CSV_NAMES, *_ROTATIONS])
    count = len(next(iter(own.values())))
    still = np.zeros(count)
    columns = [own.get(name, still) for name in CSV_NAMES] + [still] * len(_ROTATIONS)
    for index, row in enumerate(np.stack(columns, axis=1)):
        writer.writerow(
            [_timecode(index, fps), len(columns), *(f"{float(value):.10f}" for value in row)]
        )
    return out.getvalue()


def _json(curves: Curves, fps: float) -> str:
    weights = np.stack([np.asarray(curve, np.float64) for curve in curves.values()], axis=1)
    content = {
        "exportFps": fps,
        "numPoses": len(curves),
        "numFrames": len(weights),
        "facsNames": list(curves),
        "weightMat": np.round(weights, 6).tolist(),
    }
    return json.dumps(content)


def _timecode(index: int, fps: float) -> str:
    """HH:MM:SS:FF.mmm: within a second, frames and thousandths of one."""
    second = int(index / fps + 1e-9)
    thousandths = round(1000 * max(index - second * fps, 0.0))
    frame, rest = divmod(thousandths, 1000)
    return f"{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}:{frame:02d}.{rest:03d}"


def _parse_csv(text: str) -> tuple[dict[str, NDArray[np.float32]], float]:
    rows = list(csv.reader(io.StringIO(text)))
    if len(rows) < 2 or rows[0][:1] != ["Timecode"]:
        raise ValueError("no take of Live Link Face: its first line must begin with Timecode")
    names = rows[0][2:]
    values = np.asarray([row[2:] for row in rows[1:] if row], np.float32)
    curves = {
        name[0].lower() + name[1:]: values[:, k]
        for k, name in enumerate(names)
        if name not in _ROTATIONS
    }
    codes = [row[0].split(":") for row in rows[1:] if row]
    whole = [3600 * int(h) + 60 * int(m) + int(s) for h, m, s, _ in codes]
    frames = [float(code[3]) for code in codes]
    # Where the second changes, the frames of the old one have been counted to the end.
    ends = [
        2 * frames[k] - frames[k - 1] - frames[k + 1]
        for k in range(1, len(frames) - 1)
        if whole[k + 1] == whole[k] + 1 and whole[k] == whole[k - 1]
    ]
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0
    counted = float(np.median(ends)) if ends else 30.0 if max(frames) < 30 else 60.0
    return curves, round(counted / max(step, 1e-3), 3)
