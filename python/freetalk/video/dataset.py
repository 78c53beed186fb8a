"""A packed dataset of fitted clips, with what was left out and why."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from freetalk import metrics
from freetalk._files import replacing, write_json, write_text
from freetalk.audio import load_audio, save_wav
from freetalk.corpus.assets import load_face_model
from freetalk.data import import_dataset
from freetalk.data.errors import DatasetError, NotFiniteError
from freetalk.data.landmarks import lip_opening
from freetalk.data.pack import FloatArray, Pack
from freetalk.video.fit import CLOSED_M, FittedClip, FittedTalker

SPLITS = ("auto", "train", "val", "test")
#: Of a talker's clips, and of the talkers where there are so many.
_SHARES = {"test": 0.08, "val": 0.06}
_TALKERS_TO_SPLIT = 8
#: A clip with a smaller share of good frames is left out.
_LEAST_GOOD = 0.9


@dataclass(frozen=True)
class TalkerReport:
    """How well a talker's clips were fitted.

    Attributes:
        clips: that were kept.
        frames: of them.
        error_px: median reprojection error at 70 px between the outer corners of the eyes.
        opening_correlation: of the fitted opening with the tracker's gap.
        width_correlation: of the fitted width of the mouth with the tracker's.
        closed: share of the frames in which the tracker sees closed lips that are closed (0.6 mm).
        closed_gap_mm: the tracker's gap of closed lips.
        lip_jerk: mean absolute third derivative of the lip landmarks, m / s^3.
    """

    clips: int
    frames: int
    error_px: float
    opening_correlation: float
    width_correlation: float
    closed: float
    closed_gap_mm: float
    lip_jerk: float


def report_of(talker: FittedTalker, clips: Sequence[FittedClip]) -> TalkerReport:
    """How well clips of a talker were fitted."""
    gap, width = (np.concatenate([getattr(c, name) for c in clips]) for name in ("gap", "width"))
    moved = np.concatenate([c.landmarks for c in clips])
    opening, closed = lip_opening(moved), gap <= 0
    jerk = [
        np.abs(np.diff(c.landmarks[:, 48:68], 3, axis=0)) * c.track.fps**3
        for c in clips
        if len(c.landmarks) > 3
    ]
    return TalkerReport(
        clips=len(clips),
        frames=len(moved),
        error_px=float(np.median(np.concatenate([c.error_px for c in clips]))),
        opening_correlation=float(metrics.correlation(opening, gap)),
        width_correlation=float(metrics.correlation(moved[:, 54, 0] - moved[:, 48, 0], width)),
        closed=float((opening[closed] <= CLOSED_M).mean()) if closed.any() else 1.0,
        closed_gap_mm=1000 * talker.closed_gap_m,
        lip_jerk=float(np.concatenate(jerk).mean()) if jerk else 0.0,
    )


def write_dataset(
    out: Path, talkers: Sequence[FittedTalker], split: str = "auto"
) -> dict[str, Any]:
    """Packs clips as a dataset that training and evaluation open.

    Its motion is the expression weights. Beside what :mod:`freetalk.data.pack` tells, ``fit/NAME.npz`` holds the
    weights of all tracked frames, the head's pose, each frame's error and whether it is good, and the word times; ``report.json`` says how good the fit is and which clips were left out.

    Args:
        out: folder, new or empty.
        talkers: what was fitted.
        split: of all clips; ``auto`` splits eight talkers and more by talker, fewer by clip, by a hash of the name.

    Returns:
        The content of ``report.json``.

    Raises:
        ValueError: the folder holds something, an unknown split, frame rates differ, or no clip is good.
    """
    if split not in SPLITS:
        raise ValueError(f"split is {split!r}: use one of {', '.join(SPLITS)}")
    if out.exists() and any(out.iterdir()):
        raise ValueError(f"{out} is not empty: choose another folder")
    rates = sorted({round(c.track.fps, 3) for t in talkers for c in t.clips})
    if len(rates) != 1:
        raise ValueError(f"the clips have the frame rates {rates}; make one dataset of each rate")
    packed, out = out, out.with_name(f".{out.name}.recordings")
    shutil.rmtree(out, ignore_errors=True)
    reports: dict[str, TalkerReport] = {}
    left_out: dict[str, str] = {}
    rows: list[dict[str, str]] = []
    for talker in talkers:
        kept = []
        for clip in talker.clips:
            reason = _fault(clip)
            if reason:
                left_out[_name(talker, clip)] = reason
                continue
            kept.append(clip)
            rows.append(_write_clip(out, talker, clip, _split(split, talker, clip, len(talkers))))
        if kept:
            reports[talker.name] = report_of(talker, kept)
            with replacing(out / "templates" / f"{talker.name}.npy") as path:
                np.save(path, talker.neutral)
    if not rows:
        raise ValueError(
            f"no clip could be used: {'; '.join(f'{k}: {v}' for k, v in left_out.items())}"
        )
    with replacing(out / "labels.csv") as path, path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    report = {
        "talkers": {name: asdict(own) for name, own in reports.items()},
        "left_out": left_out,
        "splits": {name: sum(row["split"] == name for row in rows) for name in SPLITS[1:]},
    }
    write_json(out / "report.json", report)
    write_text(out / "dataset.json", json.dumps({"fps": rates[0], "unit": "m"}))
    import_dataset("folder", out, packed, name=packed.name)
    moved = {_name(talker, clip): clip.weights for talker in talkers for clip in talker.clips}
    write_weights(packed, load_face_model().expression_names, moved)
    for name in ("fit", "report.json"):
        (out / name).rename(packed / name)
    shutil.rmtree(out)
    return report


def _write_clip(out: Path, talker: FittedTalker, clip: FittedClip, split: str) -> dict[str, str]:
    name = _name(talker, clip)
    with replacing(out / "motion" / f"{name}.npy") as path:
        np.save(path, talker.neutral + clip.landmarks)
    (out / "wav").mkdir(exist_ok=True)
    sound = load_audio(clip.track.media)
    save_wav(out / "wav" / f"{name}.wav", sound)
    with replacing(out / "fit" / f"{name}.npz") as path:
        np.savez_compressed(
            path,
            weights=clip.weights,
            names=np.array(load_face_model().expression_names),
            rotation=clip.rotation,
            shift_m=clip.shift,
            error_px=clip.error_px,
            good=clip.good,
            gap_m=clip.gap,
            width_m=clip.width,
            words=json.dumps(clip.track.words),
        )
    return {"name": name, "speaker": talker.name, "text": clip.track.text or "", "split": split}


def _fault(clip: FittedClip) -> str:
    """Why a clip is of no use; empty if it is."""
    found, good = float(clip.track.found.mean()), float(clip.good.mean())
    if found < _LEAST_GOOD:
        return f"a face in {found:.0%} of the frames"
    if good < _LEAST_GOOD:
        return f"{good:.0%} of the frames fit (median error {np.median(clip.error_px):.1f} px)"
    return ""


def _name(talker: FittedTalker, clip: FittedClip) -> str:
    return clip.track.name if clip.track.name == talker.name else f"{talker.name}_{clip.track.name}"


def _split(asked: str, talker: FittedTalker, clip: FittedClip, talkers: int) -> str:
    if asked != "auto":
        return asked
    unit = talker.name if talkers >= _TALKERS_TO_SPLIT else _name(talker, clip)
    place = int(hashlib.sha256(unit.encode()).hexdigest()[:8], 16) / 16**8
    if place < _SHARES["test"]:
        return "test"
    return "val" if place < _SHARES["test"] + _SHARES["val"] else "train"


def write_weights(
    directory: str | Path, names: Sequence[str], weights: Mapping[str, FloatArray]
) -> None:
    """Makes the weights that moved the landmarks a part of a packed folder of landmarks alone.

    Args:
        directory: the folder.
        names: of the E expressions.
        weights: (T, E) of each sequence by its id; frames after its last are left out.

    Raises:
        DatasetError: the folder has motion already, or a sequence too few weights, or others than E.
        NotFiniteError: a weight is not finite; names its sequence.
    """
    pack = Pack(directory)
    if pack.motion is not None:
        raise DatasetError(f"{pack.directory} has motion beside its landmarks already")
    frames = np.zeros((pack.landmarks.shape[0], len(names)), np.float32)
    for entry in pack.manifest["sequences"]:
        first, count = int(entry["start_frame"]), int(entry["num_frames"])
        own = weights.get(entry["id"], np.zeros((0, len(names)), np.float32))
        if len(own) < count or own.shape[1] != len(names):
            raise DatasetError(
                f"{entry['id']}: expected weights ({count}, {len(names)}), found {own.shape}"
            )
        if not np.isfinite(own[:count]).all():
            raise NotFiniteError(f"{entry['id']}: a weight is not finite")
        frames[first : first + count] = own[:count]
    with replacing(pack.directory / "motion.npy") as temporary, temporary.open("wb") as file:
        np.save(file, frames)
    pack = Pack(directory)
    manifest = json.loads(json.dumps(pack.manifest))
    manifest["expressions"] = list(names)
    for entry in manifest["sequences"]:
        entry["sha256"] = pack.digest(entry)
    write_json(pack.directory / "manifest.json", manifest)


_MOMENTS, _CLIPS = 4, 10
_TRACKED, _FITTED = "#9a9a9a", "#c8321e"


def save_fit_picture(talker: FittedTalker, path: Path) -> None:
    """Draws up to ten clips of a talker, tracked points in grey and fitted ones in red.

    Args:
        talker: what was fitted.
        path: a PNG to write.

    Raises:
        RuntimeError: matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise RuntimeError(
            "pictures of a fit need matplotlib: pip install 'freetalk[video]'"
        ) from error
    step = max(1, len(talker.clips) // _CLIPS)
    clips = talker.clips[::step][:_CLIPS]
    figure = Figure(figsize=(16, 2.1 * len(clips)), layout="constrained")
    rows = figure.subplots(
        len(clips), _MOMENTS + 1, squeeze=False, width_ratios=[1] * _MOMENTS + [5]
    )
    for clip, row in zip(clips, rows, strict=True):
        order = np.argsort(lip_opening(clip.landmarks))
        moments = np.sort(order[np.linspace(0, len(order) - 1, _MOMENTS).astype(int)])
        for axes, moment in zip(row, moments, strict=False):
            _faces(axes, clip, int(moment))
        _curves(row[-1], clip, moments / clip.track.fps)
    canvas = FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        canvas.print_figure(temporary, dpi=70)


def _faces(axes: Any, clip: FittedClip, frame: int) -> None:
    for points, colour in ((clip.track.points, _TRACKED), (clip.projected, _FITTED)):
        axes.plot(points[frame, :, 0], points[frame, :, 1], ".", color=colour, markersize=2.5)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _curves(axes: Any, clip: FittedClip, moments: Any) -> None:
    times = np.arange(len(clip.landmarks)) / clip.track.fps
    width = clip.landmarks[:, 54, 0] - clip.landmarks[:, 48, 0]
    seen = clip.width - np.median(clip.width - width)
    for curve, colour in ((clip.gap, _TRACKED), (lip_opening(clip.landmarks), _FITTED)):
        axes.plot(times, 1000 * curve, color=colour)
    for curve, colour in ((seen, _TRACKED), (width, _FITTED)):
        axes.plot(times, 1000 * curve - 12, color=colour, linestyle="--")
    axes.vlines(moments, -20, 0, color="#d8d8d8", linewidth=0.8)
    axes.set_title(
        f"{clip.track.name}: opening, mm; dashed: width, 12 mm lower", fontsize=8, loc="left"
    )
