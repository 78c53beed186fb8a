"""Looks through a whole dataset and tells what is missing or wrong, before a night is lost."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from freetalk.data.catalogue import open_dataset
from freetalk.data.dataset import MotionDataset, MotionSequence
from freetalk.data.errors import DatasetError, Findings
from freetalk.data.open_corpus import OpenCorpus
from freetalk.data.registered import RegisteredDataset

#: A vertex of a face that speaks moves less than this (m); more means another template, unit or pose.
_LARGEST_MOTION_M = 0.08
_BLOCK = 64
#: Masks, and what is lost without them.
_MASKS = (
    ("lip_mask", "lips weigh as the rest, and lip metrics cannot be computed"),
    ("upper_face_mask", "metrics of the upper face cannot be computed"),
)


@dataclass
class DatasetReport:
    """What a check found.

    Attributes:
        errors: what stops a training.
        warnings: what a training survives and a result may not.
        facts: what the dataset is, as :meth:`MotionDataset.describe` says it, and its sizes.
    """

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether a training can start."""
        return not self.errors


def check_dataset(
    path: str | Path,
    *,
    name: str = "",
    split: str = "",
    unit: str = "auto",
    kind: str = "",
    quick: bool = False,
    progress: Any = iter,
) -> DatasetReport:
    """Opens a dataset and reads all of it; nothing that is wrong with one file hides the next.

    Args:
        path: its folder.
        name: what to call it.
        split: name of the split scheme.
        unit: length unit of the files, or ``auto``.
        kind: its layout; empty finds out.
        quick: leave out reading the motion.
        progress: wraps the sequences while they are read, such as ``tqdm``.

    Returns:
        The report; only memory and the disk itself raise.
    """
    report, findings = DatasetReport(), Findings(strict=False)
    try:
        dataset = open_dataset(
            path, name=name, split=split, unit=unit, kind=kind, findings=findings
        )
    except (DatasetError, FileNotFoundError, ValueError) as error:
        report.errors = [str(e) for e in (*findings.errors, error)]
        return report
    report.errors = [str(error) for error in findings.errors]
    report.facts = {**dataset.describe(), **_sizes(dataset)}
    try:
        dataset.check()
    except (DatasetError, FileNotFoundError, ValueError) as error:
        report.errors.append(str(error))
    _check_splits(dataset, report)
    if isinstance(dataset, RegisteredDataset):
        _check_template(dataset, report)
    if not quick:
        _read_all(dataset, report, progress)
    return report


def _sizes(dataset: MotionDataset) -> dict[str, Any]:
    sequences = dataset.sequences()
    counts: dict[str, int] = {}
    for sequence in sequences:
        label = dataset.emotions[sequence.emotion]
        counts[label] = counts.get(label, 0) + 1
    hours = sum(s.num_frames / s.fps for s in sequences) / 3600
    return {
        "hours": round(hours, 4),
        "emotions": counts,
        "speakers": {s: len(dataset.identities(s)) for s in ("train", "val", "test")},
    }


def _check_splits(dataset: MotionDataset, report: DatasetReport) -> None:
    for split, loss in (
        ("train", "nothing to train on"),
        ("val", "trainings validate on it"),
        ("test", "tables are made of it"),
    ):
        if not dataset.sequences(split):
            text = f"the split {split} is empty: {loss}"
            (report.errors if split == "train" else report.warnings).append(text)


def _check_template(dataset: RegisteredDataset, report: DatasetReport) -> None:
    described = dataset.template.describe()
    masks = () if len(dataset.template.faces) == 0 else _MASKS
    for key, loss in masks:
        if described[key] is None:
            report.warnings.append(f"no file says which vertices are the {key}: {loss}")
    if dataset.pose.unit == "normalised":
        report.warnings.append(
            f"the unit is unknown, or the landmarks belong to another mesh: {dataset.pose.reason}"
        )
    if dataset.template.name == "FLAME" and not described["faces"]["recognised"]:
        report.warnings.append("the triangles are not those of the published FLAME template")
    if dataset.left_out:
        report.warnings.append(
            f"{dataset.left_out} sequences belong to no split of {dataset.scheme.name}"
        )


def _read_all(dataset: MotionDataset, report: DatasetReport, progress: Any) -> None:
    sequences: Iterable[MotionSequence] = progress(dataset.sequences())
    topologies = set() if isinstance(dataset, OpenCorpus) else set(dataset.topologies())
    largest, where = 0.0, ""
    for sequence in sequences:
        try:
            if sequence.audio is not None:
                wave = dataset.audio(sequence)
                if float(np.abs(wave).max(initial=0.0)) < 1e-4:
                    report.warnings.append(f"{sequence.audio} is silent")
            for size in _motion(dataset, sequence, sequence.topology in topologies):
                if size > largest:
                    largest, where = size, sequence.id
        except (DatasetError, OSError, RuntimeError, ValueError) as error:
            report.errors.append(str(error))
    report.facts["largest_motion_mm"] = round(1000 * largest, 2)
    if largest > _LARGEST_MOTION_M:
        report.warnings.append(
            f"{where} moves a point by {1000 * largest:.0f} mm: is its template the speaker's, and the "
            "head's pose removed?"
        )


def _motion(
    dataset: MotionDataset, sequence: MotionSequence, has_vertices: bool
) -> Iterable[float]:
    """Largest displacement of each block of frames, read as training would."""
    for first in range(0, sequence.num_frames, _BLOCK):
        stop = first + _BLOCK
        if has_vertices:
            moved = dataset.vertex_displacements(str(sequence.topology), sequence, first, stop)
        else:
            moved = dataset.landmarks(sequence, first, stop)
        if not np.isfinite(moved).all():
            raise DatasetError(f"{sequence.id}: a frame from {first} on holds NaN or infinity")
        yield float(np.sqrt(np.square(moved).sum(axis=-1).max(initial=0.0)))
