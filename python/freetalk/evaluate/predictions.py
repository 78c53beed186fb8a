"""Scores of any system's predictions against a ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from freetalk import metrics
from freetalk.data import Mask
from freetalk.evaluate.ground_truth import GroundTruth
from freetalk.evaluate.masks import Pairs
from freetalk.evaluate.metric_specs import Available, MetricSpec, choose_metrics
from freetalk.evaluate.motion_files import (
    FloatArray,
    NameMatcher,
    Origin,
    Phones,
    motion_paths,
    read_motion,
)
from freetalk.evaluate.whole_set import WHOLE_SET, WholeSet, can_recognise

#: Frames that a metric needs at least; shorter sequences have no value of it.
_LEAST_FRAMES = {"jitter_ratio": 4, "jerk_energy": 4, "lip_correlation": 2} | dict.fromkeys(
    ("delta_m", "delta_m_l2", "delta_cd", "delta_cd_weighted"), 2
)

#: Share of a sequence by which lengths may differ: recorders and encoders stop some frames apart.
_MOST_CUT = 0.1


@dataclass
class System:
    """A system's folder of predictions.

    Attributes:
        name: as tables print it.
        directory: the folder.
        files: samples of each sequence of the ground truth.
        strangers: files that belong to no sequence.
        cut: sequences whose length differs from the truth's: (predicted, true) frames.
        frames: frames of each sequence that were scored.
    """

    name: str
    directory: Path
    files: dict[str, list[Path]]
    strangers: list[Path]
    cut: dict[str, tuple[int, int]] = field(default_factory=dict)
    frames: dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class PredictionSettings:
    """How predictions are read and scored.

    Attributes:
        metrics: see :func:`choose_metrics`.
        kind: ``vertices``, ``displacements`` or ``auto``.
        scale: metres per unit of files that do not say it; ``None``: that of the ground truth's.
        pattern: of file names, see :class:`NameMatcher`.
        strict: predictions without truth, truths without prediction, and differing lengths are errors.
        up: unit vector to the top of the head, in the ground truth's axes; ``None``: as its files say,
            else +y.
        max_offset_ms: largest offset between audio and lips that is looked for.
    """

    metrics: Sequence[str] = ()
    kind: str = "auto"
    scale: float | None = None
    pattern: str | None = None
    strict: bool = False
    up: tuple[float, float, float] | None = None
    max_offset_ms: float = 300.0


@dataclass
class Scores:
    """Values of every metric, system and sequence, in printed units.

    Attributes:
        specs: the metrics.
        systems: the systems.
        names: the sequences that all systems have.
        values: metric key, system, sequence to value (``None`` where it has none).
        reference: metric key, sequence to the value of the ground truth itself, where it has one.
        weights: metric key, sequence to weight in the pooled mean: of the ground truth, so that it is
            the same for all systems.
        origins: who speaks in each sequence, and its take.
        frames: frames of each sequence of the ground truth.
        notes: what a reader must know.
    """

    specs: list[MetricSpec]
    systems: list[System]
    names: list[str]
    values: dict[str, dict[str, dict[str, float]]]
    reference: dict[str, dict[str, float]]
    weights: dict[str, dict[str, float]]
    origins: dict[str, Origin]
    frames: dict[str, int]
    notes: list[str]


def find_predictions(
    folders: Sequence[tuple[str, Path]], truth: GroundTruth, settings: PredictionSettings
) -> tuple[list[System], list[str]]:
    """Groups each folder's files by sequence; the sequences are those that every system has.

    Raises:
        ValueError: a folder has no prediction of any sequence, or all have none in common; with
            ``strict``, anything missing or unknown.
    """
    matcher = NameMatcher(truth.names, settings.pattern)
    systems = []
    for name, directory in folders:
        paths = motion_paths(directory)
        files, strangers = matcher.group(paths)
        if not files:
            found = ", ".join(path.name for path in paths[:3]) or "no .npy or .npz"
            raise ValueError(
                f"{directory} has no prediction of the {len(truth.names)} sequences of the ground truth "
                f"({truth.names[0]} …); it holds {found}; --names tells how files are named"
            )
        if settings.strict and (strangers or len(files) < len(truth.names)):
            missing = next((n for n in truth.names if n not in files), None)
            odd = (
                f"{strangers[0].name} belongs to no sequence"
                if strangers
                else f"{missing} is missing"
            )
            raise ValueError(f"{directory}: {odd}")
        systems.append(System(name, directory, files, strangers))
    names = [n for n in truth.names if all(n in system.files for system in systems)]
    if not names:
        raise ValueError("no sequence is predicted by all systems")
    return systems, names


def score_predictions(
    folders: Sequence[tuple[str, Path]],
    truth: GroundTruth,
    masks: dict[str, Mask],
    lip_pairs: Pairs | None,
    settings: PredictionSettings,
) -> Scores:
    """Scores systems on the sequences that all of them have.

    Differing lengths: a prediction and its truth are cut to the shorter of the two, as public evaluation
    code does, whatever other systems predict, and the result says how often. More than a tenth of a
    sequence, and with ``strict`` any frame, is an error. Several samples of a sequence count by their
    mean.

    Args:
        folders: (name, folder) of each system.
        truth: the ground truth.
        masks: by name.
        lip_pairs: vertices of the upper lip and of the lower that face them.
        settings: how predictions are read.

    Raises:
        ValueError, OSError: what is missing or wrong, with the file.
    """
    systems, names = find_predictions(folders, truth, settings)
    available = Available(
        masks=list(masks),
        pairs=lip_pairs is not None,
        phones=any(truth.phones(name) for name in names),
        audio=truth.audio(names[0]) is not None,
        rate=truth.fps is not None,
        emotions=can_recognise([truth.emotion(name) for name in names]),
        neutral=truth.has_neutral,
        samples=any(len(s.files[n]) > 1 for s in systems for n in names),
    )
    specs, notes = choose_metrics(settings.metrics, available)
    scorer = _Scorer(truth, masks, lip_pairs, settings, specs)
    scores = Scores(
        specs=specs,
        systems=systems,
        names=names,
        values={spec.key: {s.name: {} for s in systems} for spec in specs},
        reference={spec.key: {} for spec in specs},
        weights={spec.key: {} for spec in specs},
        origins={name: truth.origin(name) for name in names},
        frames={},
        notes=notes,
    )
    for name in tqdm(names, desc="score", leave=False):
        scorer.score(name, scores)
    scorer.whole.finish(scores)
    _check_size(scorer.extent_m, scores)
    return scores


@dataclass(frozen=True)
class _Clip:
    """A sequence of the ground truth."""

    target: torch.Tensor
    fps: float
    phones: Phones
    energy: torch.Tensor | None

    def cut(self, frames: int) -> _Clip:
        """Its first frames."""
        if frames >= len(self.target):
            return self
        heard = [phone for phone in self.phones if round(phone[0] * self.fps) < frames]
        energy = None if self.energy is None else self.energy[:frames]
        return _Clip(self.target[:frames], self.fps, heard, energy)


class _Scorer:
    """Scores one sequence after the other."""

    def __init__(
        self,
        truth: GroundTruth,
        masks: dict[str, Mask],
        lip_pairs: Pairs | None,
        settings: PredictionSettings,
        specs: list[MetricSpec],
    ) -> None:
        self._truth, self._settings, self._specs = truth, settings, specs
        self._indices = {name: torch.from_numpy(mask.indices) for name, mask in masks.items()}
        self._pairs = lip_pairs
        self._up = settings.up or truth.up or (0.0, 1.0, 0.0)
        self._fps = truth.fps or 0.0  # metrics of time are left out where no rate is known
        self._wanted = {spec.name for spec in specs}
        self.whole = WholeSet(self._wanted, truth, self._indices)
        #: Extent of the first true frame and the greatest true motion, for a note on units.
        self.extent_m = 0.0

    def score(self, name: str, scores: Scores) -> None:
        """Adds the values of a sequence."""
        true = self._truth.motion(name)
        self.extent_m = max(self.extent_m, float(np.abs(true).max()))
        scores.frames[name] = len(true)
        clip = self._clip(name, torch.from_numpy(true))
        bilabials = sum(label in metrics.BILABIALS for _, _, label in clip.phones)
        for spec in self._specs:
            weight = {"frames": len(true), "phones": bilabials}.get(spec.pooling, 1)
            scores.weights[spec.key][name] = float(weight)
            own = self._reference(spec, clip)
            if own is not None:
                scores.reference[spec.key][name] = spec.factor * own
        self.whole.add("", name, [clip.target])
        for system in scores.systems:
            samples = self._samples(system, name, true)
            length = system.frames[name] = min(len(true), *(len(one) for one in samples))
            tensors = [torch.from_numpy(one[:length]) for one in samples]
            for spec in self._specs:
                value = self._value(spec, tensors, clip.cut(length))
                if value is not None:
                    scores.values[spec.key][system.name][name] = spec.factor * value
            self.whole.add(system.name, name, tensors)

    def _samples(self, system: System, name: str, true: FloatArray) -> list[FloatArray]:
        samples = []
        for path in system.files[name]:
            file = read_motion(path, self._truth.num_vertices)
            samples.append(self._truth.place(file, name, self._settings.kind, self._settings.scale))
            if len(samples[-1]) != len(true):
                system.cut[name] = (len(samples[-1]), len(true))
                allowed = 0 if self._settings.strict else _MOST_CUT * len(true)
                if abs(len(samples[-1]) - len(true)) > allowed:
                    raise ValueError(
                        f"{path} has {len(samples[-1])} frames, the ground truth {len(true)}"
                    )
        return samples

    def _clip(self, name: str, target: torch.Tensor) -> _Clip:
        phones = self._truth.phones(name) if "closure_rate" in self._wanted else []
        heard = [p for p in phones if 0 <= round(p[0] * self._fps) < len(target)]
        energy = None
        if "audio_offset_ms" in self._wanted and (sound := self._truth.audio(name)) is not None:
            energy = metrics.log_energy(sound[0], len(target), self._fps, sound[1])
        return _Clip(target, self._fps, heard, energy)

    def _value(self, spec: MetricSpec, samples: list[torch.Tensor], clip: _Clip) -> float | None:
        """Of one system and sequence; ``None`` where the sequence has no such value."""
        mask = self._indices.get(spec.mask)
        if spec.name in ("diversity_vertex", "lve_mean_estimate", "lve_coverage"):
            if len(samples) < 2:
                return None
            stack = torch.stack(samples)
            if spec.name == "diversity_vertex":
                return float(metrics.diversity_vertex(stack))
            return float(getattr(metrics, spec.name)(stack, clip.target, vertices=mask))
        if spec.name in WHOLE_SET or len(clip.target) < _LEAST_FRAMES.get(spec.name, 1):
            return None
        if spec.name in metrics.METRICS:
            found = [
                metrics.vertex_metric(
                    spec.name, one, clip.target, vertices=mask, fps=self._fps
                ).item()
                for one in samples
            ]
            value = float(np.mean(found))
            return value if np.isfinite(value) else None
        values = [self._lip_value(spec, one, clip) for one in samples]
        known = [value for value in values if value is not None]
        return float(np.mean(known)) if known else None

    def _lip_value(self, spec: MetricSpec, motion: torch.Tensor, clip: _Clip) -> float | None:
        opening, true = self._opening(motion), self._opening(clip.target)
        if spec.name == "lip_correlation":
            return float(metrics.correlation(opening, true))
        if spec.name == "mtm":
            found_ms = metrics.temporal_misalignment(opening, true, self._fps)
            return None if np.isnan(found_ms) else found_ms
        if spec.name == "closure_rate":
            largest = max(float(true.max()), 1e-6)
            closed = metrics.lip_closures(opening, clip.phones, self._fps, largest=largest)
            return float(np.mean(closed)) if closed else None
        leader = true if spec.name == "lip_offset_ms" else clip.energy
        if leader is None or not self._long_enough(len(true)):
            return None
        limit = self._settings.max_offset_ms
        found = metrics.best_offset(opening, leader, self._fps, max_offset_ms=limit)
        return found.offset_ms

    def _reference(self, spec: MetricSpec, clip: _Clip) -> float | None:
        """What the ground truth itself scores, where that is not the ideal by definition."""
        if spec.name == "jerk_energy" and len(clip.target) >= _LEAST_FRAMES[spec.name]:
            mask = self._indices.get(spec.mask)
            return float(metrics.jerk_energy(clip.target, self._fps, vertices=mask))
        if spec.name in ("closure_rate", "audio_offset_ms"):
            return self._lip_value(spec, clip.target, clip)
        return None

    def _opening(self, motion: torch.Tensor) -> torch.Tensor:
        assert self._pairs is not None
        return metrics.lip_opening(motion, *self._pairs, up=self._up)

    def _long_enough(self, frames: int) -> bool:
        return frames >= int(self._settings.max_offset_ms * self._fps / 1000 + 1e-9) + 4


def _check_size(largest_m: float, scores: Scores) -> None:
    """Notes a unit that can't be right: faces move by millimetres to centimetres."""
    if not 5e-4 < largest_m < 1.0:
        scores.notes.append(
            f"the true motion reaches {largest_m:.2g} m: is the unit right (--unit)? Numbers in mm are "
            "meaningless otherwise"
        )
