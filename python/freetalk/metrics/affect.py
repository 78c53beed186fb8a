"""Can the emotion be read from the face?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch

from freetalk import _native
from freetalk.metrics._arrays import batched, flags, floats, mask, text_list

if TYPE_CHECKING:
    from freetalk.metrics._arrays import Array

#: Spread, in metres, below which a coordinate tells emotions apart no better.
SPREAD_FLOOR_M = 5e-5


def affect_features(
    motion: Array, *, vertices: Array | None = None, valid: Array | None = None
) -> torch.Tensor:
    """Mean and standard deviation (ddof 0) over time of each coordinate of the mask's vertices.

    Args:
        motion: (B, T, V, 3) float, or (T, V, 3): displacements, m.
        vertices: mask of the upper face, (V,) bool or (M,) int64 indices; ``None``: all vertices.
        valid: (B, T) bool, or (T,): frames that count; ``None``: all.

    Returns:
        (B, 6M) float64, or (6M,), m.

    Raises:
        ValueError: shapes do not fit.
    """
    tensors, single = batched(floats(motion), flags(valid), dims=4)
    result: torch.Tensor = _native.metrics.affect_features(
        tensors[0], vertices=mask(vertices), valid=tensors[1]
    )
    return result[0] if single else result


class NearestCentroid:
    """Labels a feature vector by the nearest class mean, each feature divided by its spread.

    Args:
        features: (N, F) float.
        labels: N class names.
        floor: added to each feature's spread within the classes, in the features' unit.

    Raises:
        ValueError: shapes do not fit, or ``floor`` is not above 0.
    """

    def __init__(
        self, features: Array, labels: Sequence[str], *, floor: float = SPREAD_FLOOR_M
    ) -> None:
        self._native = _native.metrics.NearestCentroid(
            floats(features), text_list(labels), floor=floor
        )
        #: Class names, sorted.
        self.classes: list[str] = list(self._native.classes)

    def label(self, feature: Array) -> str:
        """The nearest class of one feature vector (F,)."""
        return self.predict(floats(feature).unsqueeze(0))[0]

    def predict(self, features: Array) -> list[str]:
        """The nearest class of each feature vector (N, F)."""
        return list(self._native.predict(floats(features)))


def recognised(
    features: Array, reference: Array, labels: Sequence[str], *, floor: float = SPREAD_FLOOR_M
) -> list[bool]:
    """Recognisability: is each label what a classifier reads that knows all *other* recordings?

    Args:
        features: (N, F) of generated motion, see :func:`affect_features`.
        reference: (N, F) of the recorded motion of the same sequences.
        labels: N class names, each at least twice.
        floor: see :class:`NearestCentroid`.

    Returns:
        N answers; the rate is their mean, chance is one over the number of classes.

    Raises:
        ValueError: shapes do not fit, or a label has one sequence only.
    """
    return _native.metrics.recognised(
        floats(features), floats(reference), labels=text_list(labels), floor=floor
    )
