"""What counts as one observation: clips of a take, and takes of a speaker, are not independent."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from freetalk.evaluate.motion_files import Origin

#: Fewer speakers than these stand for no others: their takes are drawn, and results are of them alone.
MIN_SPEAKERS = 5

_Key = TypeVar("_Key", bound=Hashable)


def clusters_of(origins: Mapping[_Key, Origin]) -> tuple[str, dict[_Key, str]]:
    """What intervals and tests draw as a whole, and which of it each sequence belongs to.

    Args:
        origins: speaker and take of each sequence.

    Returns:
        ``speakers`` where at least ``MIN_SPEAKERS`` are known, else ``takes``; the cluster's name by
        sequence.
    """
    speakers = {origin.speaker for origin in origins.values()}
    if len(speakers) >= MIN_SPEAKERS and "" not in speakers:
        return "speakers", {key: origin.speaker for key, origin in origins.items()}
    return "takes", {key: f"{origin.speaker}/{origin.take}" for key, origin in origins.items()}


def cluster_means(
    values: Mapping[_Key, float], weights: Mapping[_Key, float], clusters: Mapping[_Key, str]
) -> tuple[list[str], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Weighted mean and weight of each cluster; their weighted mean is that of the sequences.

    Args:
        values: by sequence.
        weights: by sequence, above 0.
        clusters: by sequence.

    Returns:
        Names, (C,) means and (C,) sums of weights.
    """
    sums: dict[str, list[float]] = {}
    for key, value in values.items():
        own = sums.setdefault(clusters[key], [0.0, 0.0])
        own[0] += weights[key] * value
        own[1] += weights[key]
    totals = np.array(list(sums.values()), dtype=np.float64).reshape(-1, 2)
    return list(sums), totals[:, 0] / totals[:, 1], totals[:, 1]
