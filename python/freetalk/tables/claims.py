"""What a paper claims of its table, and whether it held: paired differences with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from freetalk import metrics

HELD, OPPOSITE, UNDECIDED = "held", "did not hold", "not decided by this budget"
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
            includes; 0 where no row has several runs.
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
    claims: Sequence[Claim], rows: Mapping[str, Mapping[str, Any]], seed: int = 0
) -> list[Verdict]:
    """Verdicts on the claims whose rows are there.

    The interval of a difference is bootstrapped over clips (BCa, 95 %), each weighted by its frames, and
    widened by what other seeds change: t s sqrt(v), where s is the standard deviation of a row's mean over
    its runs, as a share of it, pooled over all rows that have several, t Student's quantile for its degrees
    of freedom, and v = sum 1 / (n^2 k) over the n rows of each side with k runs. A claim of order held where
    the whole interval is below 0, and its opposite where it is above.

    Args:
        claims: of a table.
        rows: results by name, each with ``scores`` and ``runs``.
        seed: of the bootstrap.
    """
    found = []
    for claim in claims:
        if all(name in rows for name in (*claim.less, *claim.more)):
            verdict = _judge(claim, rows, seed)
            if verdict is not None:
                found.append(verdict)
    ordered = [at for at, verdict in enumerate(found) if verdict.claim.margin == 0]
    corrected = metrics.holm([found[at].p_value for at in ordered])
    for at, p_value in zip(ordered, corrected, strict=True):
        found[at] = replace(found[at], p_value=p_value)
    return found


def _judge(claim: Claim, rows: Mapping[str, Mapping[str, Any]], seed: int) -> Verdict | None:
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
    spread, quantile = _seed_spread(claim, rows)
    shares = [
        1 / (len(side) ** 2 * len(rows[name]["runs"]))
        for side in (claim.less, claim.more)
        for name in side
    ]
    extra = quantile * spread * math.sqrt(sum(shares))
    low = interval.mean - math.hypot(interval.mean - interval.low, extra)
    high = interval.mean + math.hypot(interval.high - interval.mean, extra)
    p_value = 1.0
    if claim.margin == 0:
        p_value = metrics.permutation_test(less, more, weights, seed=seed).p_value
    outcome = _outcome(low, high, claim.margin)
    return Verdict(claim, outcome, interval.mean, low, high, p_value, len(clips), spread)


def _seed_spread(claim: Claim, rows: Mapping[str, Mapping[str, Any]]) -> tuple[float, float]:
    """Pooled standard deviation of a row's mean over its runs, as a share, and the t quantile."""
    squares, degrees = 0.0, 0
    for row in rows.values():
        means = [_mean(run, claim) for run in row["runs"]]
        if len(means) > 1:
            squares += (len(means) - 1) * float(np.var(means, ddof=1)) / float(np.mean(means)) ** 2
            degrees += len(means) - 1
    if degrees == 0:
        return 0.0, 0.0
    return math.sqrt(squares / degrees), float(stats.t.ppf(0.975, degrees))


def _outcome(low: float, high: float, margin: float) -> str:
    if margin > 0:
        if -margin <= low and high <= margin:
            return HELD
        return OPPOSITE if low > margin or high < -margin else UNDECIDED
    if high < 0:
        return HELD
    return OPPOSITE if low > 0 else UNDECIDED


def _mean(run: Mapping[str, Any], claim: Claim) -> float:
    values, frames = _values(run, claim), _frames(run)
    return float(np.average(list(values.values()), weights=[frames[clip] for clip in values]))


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
