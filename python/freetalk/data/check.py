"""Looks through a whole dataset, packed or not, and tells what is missing or wrong, before a night is lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from freetalk.data.dataset import Dataset
from freetalk.data.errors import DatasetError
from freetalk.data.importing import Source
from freetalk.data.opening import open_dataset
from freetalk.data.releases import open_release

#: A landmark of a face that speaks moves less than this (mm); more means another template, unit or pose.
_LARGEST_MOTION_MM = 80.0
#: Masks, and what is lost without them.
_MASKS = (
    ("lip_mask", "lips weigh as the rest, and lip metrics cannot be computed"),
    ("upper_face_mask", "metrics of the upper face cannot be computed"),
)
_SPLITS = (
    ("train", "nothing to train on"),
    ("val", "trainings validate on it"),
    ("test", "tables are made of it"),
)


@dataclass
class DatasetReport:
    """What a check found.

    Attributes:
        errors: what stops a training or an import, or makes a result wrong.
        warnings: what a training survives and a result may not.
        excluded: takes that are left out, and why.
        facts: what the dataset is, as :meth:`Dataset.describe` says it, and its sizes.
    """

    errors: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    excluded: dict[str, str] = field(default_factory=dict)
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """Whether a training, or an import, can start."""
        return not self.errors


def check_dataset(
    path: str | Path,
    *,
    name: str = "",
    split: str = "",
    unit: str = "auto",
    kind: str = "auto",
    quick: bool = False,
    progress: Any = iter,
) -> DatasetReport:
    """Reads all of a packed dataset against its manifest, or tells what an import of a release would do.

    Args:
        path: its folder.
        name: what to call it.
        split: name of the split scheme.
        unit: length unit of a release's files, or ``auto``.
        kind: a release's kind, or ``auto``.
        quick: leave out reading sound and motion.
        progress: wraps the takes while they are read, such as ``tqdm``.

    Returns:
        The report; only memory and the disk itself raise.
    """
    report = DatasetReport()
    try:
        if (Path(path) / "manifest.json").is_file():
            _check_packed(open_dataset(path, name=name, split=split), report, quick, progress)
        else:
            _check_release(Source(open_release(kind, path), unit=unit), report, quick, progress)
    except (DatasetError, ValueError) as error:
        report.errors.append(str(error))
    for key, loss in _MASKS:
        if report.facts.get("faces", {}).get("count") and report.facts.get(key) is None:
            report.warnings.append(f"no file says which vertices are the {key}: {loss}")
    if report.facts.get("unit") == "normalised":
        report.warnings.append(
            f"the unit is unknown, or the landmarks belong to another mesh: {report.facts['reason']}"
        )
    if report.facts.get("template") == "FLAME" and not report.facts["faces"]["recognised"]:
        report.warnings.append("the triangles are not those of the published FLAME template")
    return report


def _check_packed(dataset: Dataset, report: DatasetReport, quick: bool, progress: Any) -> None:
    ((_, pack),) = dataset.packs.items()
    sequences, entries = dataset.sequences(), pack.manifest["sequences"]
    counts = Counter(s.emotion for s in sequences)
    report.excluded = {one["id"]: one["reason"] for one in pack.manifest["excluded"]}
    report.facts = {
        **dataset.describe(),
        "hours": round(sum(s.num_frames / s.fps for s in sequences) / 3600, 4),
        "emotions": {dataset.emotions[e]: n for e, n in sorted(counts.items())},
        "speakers": {s: len(dataset.identities(s)) for s, _ in _SPLITS},
    }
    for split, loss in _SPLITS:
        if not dataset.sequences(split):
            text = f"the split {split} is empty: {loss}"
            (report.errors if split == "train" else report.warnings).append(text)
    for topology in dataset.topologies():
        pack.meshing(topology)
    _warn_of_size({e["id"]: e.get("largest_mm", 0.0) for e in entries}, report)
    if not quick:
        report.errors += [
            f"{entry['id']} is not what was written: import the dataset anew"
            for entry in progress(entries)
            if pack.digest(entry) != entry["sha256"]
        ]


def _check_release(source: Source, report: DatasetReport, quick: bool, progress: Any) -> None:
    takes = source.release.takes
    report.excluded = dict(source.release.excluded)
    report.facts = {
        **source.manifest()["facts"],
        "fps": source.fps,
        "takes": len(takes),
        "speakers": len(source.speakers),
        "splits": [scheme.name for scheme in source.schemes],
    }
    sizes = {}
    for take in [] if quick else progress(takes):
        try:
            sizes[take.id] = source.read(take).largest_mm
        except DatasetError as error:
            report.excluded[take.id] = str(error)
    _warn_of_size(sizes, report)
    if takes and len(report.excluded) >= len(takes):
        report.errors.append("no take is usable")


def _warn_of_size(sizes: dict[str, float], report: DatasetReport) -> None:
    if not sizes:
        return
    where = max(sizes, key=lambda name: sizes[name])
    report.facts["largest_motion_mm"] = sizes[where]
    if sizes[where] > _LARGEST_MOTION_MM:
        report.warnings.append(
            f"{where} moves a landmark by {sizes[where]:.0f} mm: is its template the speaker's, and the "
            "head's pose removed?"
        )
