"""What a paper claims of its table, and whether it held: paired differences with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk import metrics
from freetalk.evaluate.clusters import cluster_means, clusters_of
from freetalk.evaluate.motion_files import Origin

#: Trainings of each row that a verdict needs; fewer leave a claim undecided, however clear the clips are.
MIN_SEEDS = 3
_DRAWS = 10000
#: A corrected p-value from here on leaves a claim of order undecided.
_LEVEL = 0.05

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
        p_value: twice the share of the draws behind the interval in which the order is the other,
            corrected for the table's claims (Holm); 1 for a claim with a margin, which asks no such
            question.
        clips: how many were compared.
        drawn: what was drawn as a whole, ``speakers`` or ``takes``, and how many there are.
        seeds: the fewest trainings of a row that is compared.
        seed_spread: standard deviation of a row's mean over seeds, as a share of it, that interval and
            p-value include; 0 where no row has several runs.
    """

    claim: Claim
    outcome: str
    difference: float
    low: float
    high: float
    p_value: float
    clips: int
    drawn: tuple[str, int]
    seeds: int
    seed_spread: float

    def to_dict(self) -> dict[str, Any]:
        """As stored."""
        own = ("outcome", "difference", "p_value", "clips", "seeds", "seed_spread")
        claim = self.claim
        return {
            "claim": claim.text,
            "source": claim.source,
            "less": list(claim.less),
            "more": list(claim.more),
            "metric": claim.metric,
            "dataset": claim.dataset or "all",
            "margin": claim.margin,
            "low": None if math.isnan(self.low) else self.low,
            "high": None if math.isnan(self.high) else self.high,
            "drawn": {"what": self.drawn[0], "count": self.drawn[1]},
            **{name: getattr(self, name) for name in own},
        }


def judge(
    claims: Sequence[Claim], rows: Mapping[str, Mapping[str, Any]], seed: int = 0
) -> list[Verdict]:
    """Verdicts on the claims whose rows are there.

    Interval (95 %) and p-value come from the same draws of the difference. A draw takes speakers or takes
    (:func:`clusters_of`) with replacement, each clip weighted by its frames, stretched by sqrt(n / (n - 1))
    for the n of them, and adds what other seeds change: s sqrt(v) t, where s is the standard deviation of
    a row's mean over its runs, as a share of it, pooled over all rows that have several, v = sum 1 /
    (m^2 k) over the m rows of each side with k runs, and t is drawn from Student's distribution with its
    degrees of freedom. A claim of order held where the whole interval is below 0, and its opposite where
    it is above, the p-value corrected for the table's claims (Holm) being below 0.05; with fewer than
    ``MIN_SEEDS`` trainings of a row, or fewer than two takes, neither did.

    Args:
        claims: of a table.
        rows: results by name, each with ``scores`` and ``runs``.
        seed: of the draws.
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
        outcome = found[at].outcome if p_value < _LEVEL else UNDECIDED
        found[at] = replace(found[at], p_value=p_value, outcome=outcome)
    return found


def _judge(claim: Claim, rows: Mapping[str, Mapping[str, Any]], seed: int) -> Verdict | None:
    sides = [[_values(rows[name], claim) for name in side] for side in (claim.less, claim.more)]
    clips = [c for c in sides[0][0] if all(c in one for side in sides for one in side)]
    if len(clips) < 2:
        return None
    frames = _frames(rows[claim.less[0]])
    weights = {clip: float(frames[clip]) for clip in clips}
    less, more = ({c: float(np.mean([one[c] for one in side])) for c in clips} for side in sides)
    scale = float(np.average(list(more.values()), weights=list(weights.values()))) or 1.0
    unit, clusters = clusters_of(origins_of(rows[claim.less[0]], clips))
    differences = {clip: (less[clip] - more[clip]) / scale for clip in clips}
    _, means, sums = cluster_means(differences, weights, clusters)
    spread, degrees = _seed_spread(claim, rows)
    runs = [len(rows[name]["runs"]) for name in (*claim.less, *claim.more)]
    sizes = [len(side) for side in (claim.less, claim.more) for _ in side]
    noise = spread * math.sqrt(sum(1 / (size**2 * k) for size, k in zip(sizes, runs)))
    difference = float(np.average(means, weights=sums))
    low = high = math.nan
    p_value, outcome = 1.0, UNDECIDED
    if len(means) > 1:
        draws = _draws(means, sums, noise, degrees, seed)
        low, high = (float(q) for q in np.quantile(draws, (0.025, 0.975)))
        if claim.margin == 0:
            least = min(int((draws <= 0).sum()), int((draws >= 0).sum()))
            p_value = min(1.0, 2 * (least + 1) / (len(draws) + 1))
        outcome = _outcome(low, high, claim.margin) if min(runs) >= MIN_SEEDS else UNDECIDED
    return Verdict(
        claim=claim,
        outcome=outcome,
        difference=difference,
        low=low,
        high=high,
        p_value=p_value,
        clips=len(clips),
        drawn=(unit, len(means)),
        seeds=min(runs),
        seed_spread=spread,
    )


def _draws(
    means: npt.NDArray[np.float64],
    sums: npt.NDArray[np.float64],
    noise: float,
    degrees: int,
    seed: int,
) -> npt.NDArray[np.float64]:
    """Differences that other clusters and other seeds might have given, (draws,)."""
    rng = np.random.default_rng(seed)
    count = len(means)
    chosen = rng.integers(count, size=(_DRAWS, count))
    drawn = (means * sums)[chosen].sum(axis=1) / sums[chosen].sum(axis=1)
    middle = np.average(means, weights=sums)
    drawn = middle + math.sqrt(count / (count - 1)) * (drawn - middle)
    if degrees > 0:
        drawn += noise * rng.standard_t(degrees, _DRAWS)
    return drawn


def _seed_spread(claim: Claim, rows: Mapping[str, Mapping[str, Any]]) -> tuple[float, int]:
    """Pooled standard deviation of a row's mean over its runs, as a share; its degrees of freedom."""
    squares, degrees = 0.0, 0
    for row in rows.values():
        if len(row["runs"]) < 2:
            continue
        means = [_mean(run, claim) for run in row["runs"]]
        if np.mean(means) != 0:  # of zero there is no share
            squares += (len(means) - 1) * float(np.var(means, ddof=1)) / float(np.mean(means)) ** 2
            degrees += len(means) - 1
    return (math.sqrt(squares / degrees), degrees) if degrees else (0.0, 0)


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


def origins_of(row: Mapping[str, Any], clips: Sequence[_Clip]) -> dict[_Clip, Origin]:
    """Speaker and take of clips, apart by test set; a clip without them is a take of its own."""
    found = {}
    for name, clip in clips:
        speaker, take = row["scores"][name].get("origins", {}).get(clip, ("", clip))
        found[name, clip] = Origin(speaker and f"{name}/{speaker}", f"{name}/{take}")
    return found
