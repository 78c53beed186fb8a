"""From the values of sequences to a result: pooled means, confidence intervals, paired tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import freetalk
from freetalk import metrics
from freetalk.data import Mask
from freetalk.evaluate.clusters import cluster_means, clusters_of
from freetalk.evaluate.ground_truth import GroundTruth
from freetalk.evaluate.masks import describe_masks
from freetalk.evaluate.metric_specs import MetricSpec
from freetalk.evaluate.predictions import Scores

FORMAT = "freetalk-scores"
#: Metrics that by their nature not every sequence has.
_PARTIAL = (
    *("closure_rate", "emotion_rate", "audio_offset_ms", "mtm", "slcc"),
    *("diversity_vertex", "lve_mean_estimate", "lve_coverage"),
)


@dataclass(frozen=True)
class StatisticsSettings:
    """Intervals and tests.

    Attributes:
        confidence: of the intervals.
        num_resamples: bootstrap resamples, and sign patterns of the permutation test.
        method: of the bootstrap, ``bca`` or ``percentile``.
        seed: same seed, same numbers.
        baseline: system that the others are compared with; ``None``: the first.
    """

    confidence: float = 0.95
    num_resamples: int = 10000
    method: str = "bca"
    seed: int = 0
    baseline: str | None = None


def make_report(
    scores: Scores, truth: GroundTruth, masks: dict[str, Mask], settings: StatisticsSettings
) -> dict[str, Any]:
    """A result that can be written as JSON and printed as a table.

    Every metric has, for each system, the pooled mean with its interval and the values of the
    sequences; with several systems, paired tests against the baseline. Intervals and tests draw whole
    speakers or takes (:func:`clusters_of`). Tests compare distances from the ideal, so that a signed
    metric (FDD) is better the nearer it is to 0. ``p_holm`` is the permutation test's p-value corrected
    for all metrics and systems of the report.

    Raises:
        ValueError: no system is called as the baseline is.
    """
    names = [system.name for system in scores.systems]
    baseline = settings.baseline or names[0]
    if baseline not in names:
        raise ValueError(f"no system is called {baseline!r}; there are {', '.join(names)}")
    unit, clusters = clusters_of(scores.origins)
    rows = [_row(spec, scores, clusters, settings) for spec in scores.specs]
    others = [name for name in names if name != baseline]
    tests = [
        test
        for spec, row in zip(scores.specs, rows)
        for name in others
        if (test := _compare(spec, row, scores, clusters, name, baseline, settings)) is not None
    ]
    for test, corrected in zip(tests, metrics.holm([t["p_permutation"] for t in tests])):
        test["p_holm"] = corrected
    return {
        "format": FORMAT,
        "version": 1,
        "freetalk": freetalk.__version__,
        "ground_truth": {**truth.describe(), "sequences_scored": len(scores.names)},
        "masks": describe_masks(masks, truth.num_vertices),
        "frames": sum(scores.frames.values()),
        "systems": describe_systems(scores, truth),
        "baseline": baseline if others else None,
        "metrics": rows,
        "statistics": {
            "intervals": f"{settings.method} bootstrap over {unit}",
            "drawn": unit,
            "count": len(set(clusters.values())),
            "confidence": settings.confidence,
            "resamples": settings.num_resamples,
            "seed": settings.seed,
        },
        "notes": [*scores.notes, *_notes(scores)],
    }


def pooled(
    values: dict[str, float],
    weights: dict[str, float],
    clusters: Mapping[str, str],
    settings: StatisticsSettings,
) -> dict[str, Any]:
    """Mean, interval and the values that they are of."""
    options = metrics.BootstrapOptions(
        num_resamples=settings.num_resamples, confidence=settings.confidence, method=settings.method
    )
    _, means, sums = cluster_means(values, weights, clusters)
    interval = metrics.bootstrap_mean(means, sums, options=options, seed=settings.seed)
    return {
        "mean": interval.mean,
        "low": _known(interval.low),
        "high": _known(interval.high),
        "sequences": len(values),
        "per_sequence": values,
    }


def _row(
    spec: MetricSpec, scores: Scores, clusters: Mapping[str, str], settings: StatisticsSettings
) -> dict[str, Any]:
    weights = scores.weights[spec.key]
    reference = scores.reference[spec.key]
    return {
        "metric": spec.key,
        "title": spec.title,
        "mask": spec.mask,
        "unit": spec.unit,
        "mean_over": spec.pooling,
        "better": spec.direction,
        "ideal": _known(spec.ideal),
        "formula": spec.formula,
        "source": spec.source,
        "systems": {
            name: pooled(values, weights, clusters, settings)
            for name, values in scores.values[spec.key].items()
            if values
        },
        "ground_truth": pooled(reference, weights, clusters, settings) if reference else None,
        "paired": {},
    }


def _compare(
    spec: MetricSpec,
    row: dict[str, Any],
    scores: Scores,
    clusters: Mapping[str, str],
    name: str,
    baseline: str,
    settings: StatisticsSettings,
) -> dict[str, Any] | None:
    """Adds the paired tests of a system to a row."""
    ours, theirs = scores.values[spec.key][name], scores.values[spec.key][baseline]
    shared = [n for n in ours if n in theirs]
    if not shared or math.isnan(spec.ideal):
        return None
    near = [{n: spec.distance(values[n]) for n in shared} for values in (ours, theirs)]
    weights = scores.weights[spec.key]
    (_, a, sums), (_, b, _) = (cluster_means(one, weights, clusters) for one in near)
    permutation = metrics.permutation_test(
        a, b, sums, num_resamples=settings.num_resamples, seed=settings.seed
    )
    wilcoxon = metrics.wilcoxon_test(a, b)
    test = {
        "against": baseline,
        "difference": permutation.statistic,
        "sequences_better": sum(near[0][n] < near[1][n] for n in shared),
        "sequences_worse": sum(near[0][n] > near[1][n] for n in shared),
        "p_permutation": permutation.p_value,
        "p_wilcoxon": wilcoxon.p_value,
    }
    row["paired"][name] = test
    return test


def describe_systems(scores: Scores, truth: GroundTruth) -> list[dict[str, Any]]:
    """What results say of each folder: how many of its files were scored, and which were cut."""
    result = []
    for system in scores.systems:
        samples = [len(system.files[name]) for name in scores.names]
        differences = [abs(a - b) for a, b in system.cut.values()]
        result.append(
            {
                "name": system.name,
                "source": str(system.directory),
                "sequences": len(scores.names),
                "sequences_of_ground_truth": len(truth.names),
                "sequences_of_its_own": len(system.files),
                "frames": sum(system.frames.values()),
                "samples": sum(samples),
                "files_of_no_sequence": [path.name for path in system.strangers],
                "sequences_cut": len(system.cut),
                "most_frames_cut": max(differences, default=0),
            }
        )
    return result


def _notes(scores: Scores) -> list[str]:
    notes = []
    for system in scores.systems:
        if system.cut:
            most = max(abs(a - b) for a, b in system.cut.values())
            notes.append(
                f"{system.name}: {len(system.cut)} of {len(scores.names)} sequences differ in length from "
                f"the ground truth, by at most {most} frames; prediction and truth were cut to the shorter"
            )
        if system.strangers:
            notes.append(
                f"{system.name}: {len(system.strangers)} files belong to no sequence of the ground truth "
                f"({system.strangers[0].name} …)"
            )
        left = len(system.files) - len(scores.names)
        if left:
            notes.append(f"{system.name}: {left} of its sequences lack in another system")
    for spec in scores.specs:
        for name, values in scores.values[spec.key].items():
            lost = len(scores.names) - len(values)
            if lost and values and spec.name not in _PARTIAL:
                notes.append(f"{spec.key}: {lost} sequences of {name} have no value")
    return notes


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
