"""What a paper claims of its table, and whether it held: paired differences with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk import metrics

HELD, OPPOSITE, UNDECIDED = "held", "did not hold", "not decided by this budget"
#: Student's t at 97.5 % for 1, 2, ... degrees of freedom.
_QUANTILES = (12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228)
_Clip = tuple[str, str]


@dataclass(frozen=True)
class Claim:
    """That some rows score lower than others, or about the same.

    Attributes:
        text: what the paper says, in our words.
        source: where, with its numbers.
        less: rows that it says score lower; the mean of their values clip by clip counts.
        more: rows that it says score higher, likewise.
        metric: of the table; lower is better.
        dataset: whose clips count; empty: those of all test sets.
        margin: above 0, the claim is that `less` and `more` differ by no more than this share of the
            mean of `more`.
    """

    text: str
    source: str
    less: tuple[str, ...]
    more: tuple[str, ...]
    metric: str = "lve"
    dataset: str = ""
    margin: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """What came out.

    Attributes:
        claim: the claim.
        outcome: ``held``, ``did not hold`` or ``not decided by this budget``.
        difference: mean of less - more, as a share of the mean of `more`.
        low: lower end of its 95 % interval.
        high: upper end.
        p_value: of a permutation test over clips that the two are alike, corrected for the table's
            claims (Holm); 1 for a claim with a margin, which asks no such question.
        clips: how many were compared.
        seed_spread: standard deviation of a row's mean over seeds, as a share of it, that the interval
            includes; 0 where no row has several.
    """

    claim: Claim
    outcome: str
    difference: float
    low: float
    high: float
    p_value: float
    clips: int
    seed_spread: float

    def to_dict(self) -> dict[str, Any]:
        """As stored."""
        own = ("outcome", "difference", "low", "high", "p_value", "clips", "seed_spread")
        claim = self.claim
        return {
            "claim": claim.text,
            "source": claim.source,
            "less": list(claim.less),
            "more": list(claim.more),
            "metric": claim.metric,
            "dataset": claim.dataset or "all",
            "margin": claim.margin,
            **{name: getattr(self, name) for name in own},
        }


def judge(
    claims: Sequence[Claim],
    rows: Mapping[str, Mapping[str, Any]],
    repeats: Sequence[str] = (),
    seed: int = 0,
) -> list[Verdict]:
    """Verdicts on the claims whose rows are there.

    The interval of a difference is bootstrapped over clips (BCa, 95 %), each weighted by its frames, and
    widened by what another seed changes: t s sqrt(1/n + 1/m) for n and m rows, s the spread of `repeats`,
    t Student's quantile. A claim of order held where the whole interval is below 0, and its opposite where
    it is above.

    Args:
        claims: of a table.
        rows: results by name, each with ``scores``.
        repeats: rows that differ in their seed alone.
        seed: of the bootstrap.
    """
    found = []
    for claim in claims:
        if all(name in rows for name in (*claim.less, *claim.more)):
            verdict = _judge(claim, rows, [name for name in repeats if name in rows], seed)
            if verdict is not None:
                found.append(verdict)
    ordered = [at for at, verdict in enumerate(found) if verdict.claim.margin == 0]
    corrected = metrics.holm([found[at].p_value for at in ordered])
    for at, p_value in zip(ordered, corrected, strict=True):
        found[at] = replace(found[at], p_value=p_value)
    return found


def _judge(
    claim: Claim, rows: Mapping[str, Mapping[str, Any]], repeats: Sequence[str], seed: int
) -> Verdict | None:
    sides = [[_values(rows[name], claim) for name in side] for side in (claim.less, claim.more)]
    clips = [c for c in sides[0][0] if all(c in one for side in sides for one in side)]
    if len(clips) < 2:
        return None
    frames = _frames(rows[claim.less[0]])
    weights = np.array([frames[clip] for clip in clips], dtype=np.float64)
    less, more = (
        np.array([[one[c] for c in clips] for one in side]).mean(axis=0) for side in sides
    )
    scale = float((more * weights).sum() / weights.sum()) or 1.0
    interval = metrics.bootstrap_mean((less - more) / scale, weights, seed=seed)
    means = [_mean(_values(rows[name], claim), clips, weights) for name in repeats]
    spread, quantile = _spread(means)
    extra = quantile * spread * math.sqrt(1 / len(claim.less) + 1 / len(claim.more))
    low = interval.mean - math.hypot(interval.mean - interval.low, extra)
    high = interval.mean + math.hypot(interval.high - interval.mean, extra)
    p_value = 1.0
    if claim.margin == 0:
        p_value = metrics.permutation_test(less, more, weights, seed=seed).p_value
    outcome = _outcome(low, high, claim.margin)
    return Verdict(claim, outcome, interval.mean, low, high, p_value, len(clips), spread)


def _spread(means: Sequence[float]) -> tuple[float, float]:
    """Standard deviation as a share of the mean, and the t quantile of its degrees of freedom."""
    if len(means) < 2:
        return 0.0, 0.0
    degrees = len(means) - 1
    quantile = _QUANTILES[min(degrees, len(_QUANTILES)) - 1]
    return float(np.std(means, ddof=1) / np.mean(means)), quantile


def _outcome(low: float, high: float, margin: float) -> str:
    if margin > 0:
        if -margin <= low and high <= margin:
            return HELD
        return OPPOSITE if low > margin or high < -margin else UNDECIDED
    if high < 0:
        return HELD
    return OPPOSITE if low > 0 else UNDECIDED


def _mean(
    values: Mapping[_Clip, float], clips: Sequence[_Clip], weights: npt.NDArray[np.float64]
) -> float:
    return float(np.average([values[clip] for clip in clips], weights=weights))


def _values(row: Mapping[str, Any], claim: Claim) -> dict[_Clip, float]:
    return {
        (name, clip): value
        for name, scores in row["scores"].items()
        if claim.dataset in ("", name)
        for clip, value in scores["values"].get(claim.metric, {}).items()
    }


def _frames(row: Mapping[str, Any]) -> dict[_Clip, int]:
    return {
        (name, clip): frames
        for name, scores in row["scores"].items()
        for clip, frames in scores["frames"].items()
    }
