"""Which metrics are scored, over which mask, and in which unit they are printed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from freetalk.metrics import METRICS, metric_info

#: As metrics give them, as tables print them, and the factor between.
_SHOWN_UNITS = {"m": ("mm", 1e3), "m^2": ("mm^2", 1e6)}


@dataclass(frozen=True)
class MetricSpec:
    """A metric over a mask.

    Attributes:
        key: as it is asked for, ``lve`` or ``delta_m@lips``.
        name: of the metric.
        title: as tables print it.
        mask: name of a mask, or ``all``.
        unit: as printed.
        factor: from SI to the printed unit.
        pooling: a test set's number is the mean over all its ``frames``, ``sequences`` or ``phones``.
        ideal: what a perfect prediction scores.
        two_sided: both sides of the ideal are possible, nearer is better.
        formula: what is computed.
        source: who defined it.
    """

    key: str
    name: str
    title: str
    mask: str
    unit: str
    factor: float
    pooling: str
    ideal: float
    two_sided: bool
    formula: str
    source: str

    def distance(self, value: float) -> float:
        """How far from ideal; less is better."""
        return abs(value - self.ideal)

    @property
    def direction(self) -> str:
        """``down``, ``up`` or ``near``: which way is better."""
        if self.two_sided:
            return "near"
        return "up" if self.ideal > 0 else "down"


_PROBTALK, _PERCEPTUAL = "ProbTalk3D", "Chae-Yeon et al., CVPR 2025"
#: Metrics that need more than two motions: lip pairs, phones, audio, labels or several samples.
#: Name, title, mask, unit, factor, pooling, ideal, two-sided, formula, source.
EXTRAS: dict[str, MetricSpec] = {
    row[0]: MetricSpec(row[0], *row)
    for row in (
        ("lip_correlation", "lip corr.", "lips", "1", 1.0, "sequences", 1, False,
         "Pearson's correlation of the lip openings", "freetalk"),
        ("lip_offset_ms", "lip offset", "lips", "ms", 1.0, "sequences", 0, True,
         "lag of the predicted behind the true lip opening", "freetalk"),
        ("mtm", "MTM", "lips", "ms", 1.0, "sequences", 0, False,
         "mean distance in time of the peaks and valleys of predicted and true lip opening that derivative dynamic "
         "time warping joins", _PERCEPTUAL),
        ("slcc", "SLCC", "lips", "1", 1.0, "sequences", float("nan"), True,
         "correlation over clips of speech's RMS and the lips' RMS step, normalised by speaker; nearer to the ground "
         "truth's is better", _PERCEPTUAL),
        ("audio_offset_ms", "audio offset", "lips", "ms", 1.0, "sequences", 0, True,
         "lag of the lip opening behind the audio's log energy", "freetalk"),
        ("closure_rate", "closures", "lips", "1", 1.0, "phones", 1, False,
         "share of p, b, m at which the lips close to 15 % of the true largest opening", "freetalk"),
        ("emotion_rate", "emotion", "upper", "1", 1.0, "sequences", 1, False,
         "share of sequences whose emotion a nearest-centroid classifier reads, which knows the ground truth of the "
         "others", "freetalk"),
        ("diversity_vertex", "diversity", "all", "mm", 1e3, "sequences", float("nan"), False,
         "mean over pairs of samples, frames and vertices of |p_jtv - p_ltv|", "FaceDiffuser"),
        ("lve_mean_estimate", "MEE", "lips", "mm^2", 1e6, "frames", 0, False, "LVE of the mean of the samples", _PROBTALK),
        ("lve_coverage", "CE", "lips", "mm^2", 1e6, "frames", 0, False, "least LVE of the samples", _PROBTALK),
    )
}  # fmt: skip

#: The metrics of FreeTalk's tables.
PAPER = ("lve", "mve_mean", "fdd", "dtw", "dfd", "delta_m", "delta_cd")
_DEFAULT = (*PAPER, "jitter_ratio", *EXTRAS)
_NEEDS_AUDIO = ("audio_offset_ms", "slcc")
_NEEDS_PAIRS = ("lip_correlation", "mtm", "lip_offset_ms", "audio_offset_ms", "closure_rate")
_NEEDS_SAMPLES = ("diversity_vertex", "lve_mean_estimate", "lve_coverage")
_NEEDS_RATE = ("mtm", "jerk_energy", "lip_offset_ms", "audio_offset_ms", "closure_rate")
_NEEDS_NEUTRAL = ("fdd", "fdd_abs", "closure_rate", "emotion_rate")


@dataclass(frozen=True)
class Available:
    """What the data has that some metrics need."""

    masks: Collection[str]
    pairs: bool
    phones: bool
    audio: bool
    emotions: bool
    neutral: bool
    rate: bool
    samples: bool


def spec_of(key: str) -> MetricSpec:
    """A metric by name, ``NAME`` or ``NAME@MASK``.

    Raises:
        ValueError: no such metric.
    """
    name, _, mask = key.partition("@")
    if name in EXTRAS:
        if mask and mask != EXTRAS[name].mask:
            raise ValueError(f"{name} is measured over {EXTRAS[name].mask} only")
        return EXTRAS[name]
    info = metric_info(name)
    unit, factor = _SHOWN_UNITS.get(info.unit, (info.unit, 1.0))
    title = info.title if mask in ("", info.mask) else f"{info.title} @ {mask}"
    return MetricSpec(
        key=key,
        name=name,
        title=title,
        mask=mask or info.mask,
        unit=unit,
        factor=factor,
        pooling=info.pooling,
        ideal=info.ideal,
        two_sided=info.two_sided,
        formula=info.formula,
        source=info.source,
    )


def choose_metrics(
    asked: Sequence[str], available: Available
) -> tuple[list[MetricSpec], list[str]]:
    """The metrics to score, and which of the usual ones are left out, and why.

    Args:
        asked: names; ``paper`` for those of FreeTalk's tables, ``all`` for every variant; empty for the
            usual ones. What is asked for by name must be possible.
        available: what the data has.

    Raises:
        ValueError: an unknown metric, or one that lacks what it needs.
    """
    groups = {"paper": PAPER, "all": (*METRICS, *EXTRAS)}
    wanted: list[tuple[str, bool]] = []
    for name in asked or ("usual",):
        if name == "usual":
            wanted += [(each, False) for each in _DEFAULT]
        elif name in groups:
            wanted += [(each, False) for each in groups[name]]
        else:
            wanted.append((name, True))
    chosen: dict[str, MetricSpec] = {}
    notes = []
    for key, must in wanted:
        spec = spec_of(key)
        lacking = _lacking(spec, available)
        if lacking is None:
            chosen.setdefault(spec.key, spec)
        elif must:
            raise ValueError(f"{key} needs {lacking}")
        elif spec.name not in _NEEDS_SAMPLES:
            notes.append(f"{spec.name} left out: it needs {lacking}")
    if not chosen:
        raise ValueError("no metric can be scored: " + "; ".join(notes))
    return list(chosen.values()), list(dict.fromkeys(notes))


def _lacking(spec: MetricSpec, has: Available) -> str | None:
    if spec.name in _NEEDS_PAIRS:
        if not has.pairs:
            return "--lip-pairs"
    elif spec.mask != "all" and spec.mask not in has.masks:
        return f"a mask called {spec.mask} (--masks {spec.mask}=FILE)"
    if spec.name in _NEEDS_RATE and not has.rate:
        return "the frame rate (--fps)"
    if spec.name in _NEEDS_NEUTRAL and not has.neutral:
        return "neutral faces (--templates)"
    if spec.name == "closure_rate" and not has.phones:
        return "--phones"
    if spec.name in _NEEDS_AUDIO and not has.audio:
        return "audio (--wav)"
    if spec.name == "emotion_rate" and not has.emotions:
        return "two sequences at least of each of two emotions (--emotions)"
    if spec.name in _NEEDS_SAMPLES and not has.samples:
        return "several samples of a sequence"
    return None
