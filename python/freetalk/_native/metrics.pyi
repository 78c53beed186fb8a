from __future__ import annotations
import collections.abc
import torch
import typing

__all__: list[str] = [
    "BootstrapOptions",
    "Interval",
    "MetricInfo",
    "NearestCentroid",
    "PairedTest",
    "affect_features",
    "best_offset",
    "bootstrap_mean",
    "correlation",
    "diversity",
    "diversity_vertex",
    "holm",
    "jerk_energy",
    "lip_closures",
    "lip_opening",
    "log_energy",
    "lve_coverage",
    "lve_mean_estimate",
    "metric_info",
    "permutation_test",
    "recognised",
    "vertex_metric",
    "vertex_metrics",
    "wilcoxon_test",
]

class MetricInfo:
    """
    What a vertex metric measures, and where from.
    """
    @property
    def formula(self) -> str: ...
    @property
    def ideal(self) -> float:
        """
        What a perfect prediction scores.
        """
    @property
    def mask(self) -> str:
        """
        'lips', 'upper' or 'all'.
        """
    @property
    def name(self) -> str: ...
    @property
    def pooling(self) -> str:
        """
        'frames' or 'sequences'.
        """
    @property
    def source(self) -> str: ...
    @property
    def title(self) -> str:
        """
        As tables print it.
        """
    @property
    def two_sided(self) -> bool:
        """
        Nearer to ideal is better.
        """
    @property
    def unit(self) -> str:
        """
        Of motion in metres.
        """

class NearestCentroid:
    """
    Labels by the nearest class mean.
    """
    def __init__(
        self,
        features: torch.Tensor,
        labels: collections.abc.Sequence[str],
        *,
        floor: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def predict(self, features: torch.Tensor) -> list[str]: ...
    @property
    def classes(self) -> list[str]: ...

class BootstrapOptions:
    """
    Bootstrap over sequences.
    """

    __hash__: typing.ClassVar[None] = None
    confidence: typing.Any
    method: typing.Any
    num_resamples: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> BootstrapOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: BootstrapOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Interval:
    """
    A mean and its confidence interval.
    """
    @property
    def high(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def mean(self) -> float: ...

class PairedTest:
    """
    Outcome of a paired test.
    """
    @property
    def p_value(self) -> float:
        """
        Two-sided.
        """
    @property
    def statistic(self) -> float: ...

def affect_features(
    motion: torch.Tensor, *, vertices: torch.Tensor | None = None, valid: torch.Tensor | None = None
) -> torch.Tensor: ...
def best_offset(
    follower: torch.Tensor,
    leader: torch.Tensor,
    *,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    max_offset_ms: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[float, float]: ...
def bootstrap_mean(
    values: torch.Tensor,
    weights: torch.Tensor | None,
    *,
    options: BootstrapOptions,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> Interval: ...
def correlation(
    a: torch.Tensor, b: torch.Tensor, *, valid: torch.Tensor | None = None
) -> torch.Tensor: ...
def diversity(codes: torch.Tensor) -> torch.Tensor: ...
def diversity_vertex(
    samples: torch.Tensor,
    *,
    vertices: torch.Tensor | None = None,
    valid: torch.Tensor | None = None,
) -> torch.Tensor: ...
def holm(
    p_values: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
) -> list[float]: ...
def jerk_energy(
    motion: torch.Tensor,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    *,
    vertices: torch.Tensor | None = None,
    valid: torch.Tensor | None = None,
) -> torch.Tensor: ...
def lip_closures(
    opening: torch.Tensor,
    phones: collections.abc.Sequence[
        tuple[
            typing.SupportsFloat | typing.SupportsIndex,
            typing.SupportsFloat | typing.SupportsIndex,
            str,
        ]
    ],
    *,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    closed: typing.SupportsFloat | typing.SupportsIndex,
    share: typing.SupportsFloat | typing.SupportsIndex,
    largest: typing.SupportsFloat | typing.SupportsIndex,
) -> list[bool]: ...
def lip_opening(
    motion: torch.Tensor, upper: torch.Tensor, *, lower: torch.Tensor, up: torch.Tensor
) -> torch.Tensor: ...
def log_energy(
    wave: torch.Tensor,
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    *,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    sample_rate_hz: typing.SupportsFloat | typing.SupportsIndex,
) -> torch.Tensor: ...
def lve_coverage(
    samples: torch.Tensor,
    target: torch.Tensor,
    *,
    vertices: torch.Tensor | None = None,
    valid: torch.Tensor | None = None,
) -> torch.Tensor: ...
def lve_mean_estimate(
    samples: torch.Tensor,
    target: torch.Tensor,
    *,
    vertices: torch.Tensor | None = None,
    valid: torch.Tensor | None = None,
) -> torch.Tensor: ...
def metric_info(name: str) -> MetricInfo: ...
def permutation_test(
    a: torch.Tensor,
    b: torch.Tensor,
    *,
    weights: torch.Tensor | None,
    num_resamples: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> PairedTest: ...
def recognised(
    features: torch.Tensor,
    reference: torch.Tensor,
    *,
    labels: collections.abc.Sequence[str],
    floor: typing.SupportsFloat | typing.SupportsIndex,
) -> list[bool]: ...
def vertex_metric(
    name: str,
    pred: torch.Tensor,
    target: torch.Tensor,
    *,
    vertices: torch.Tensor | None = None,
    valid: torch.Tensor | None = None,
    target_valid: torch.Tensor | None = None,
    fps: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> torch.Tensor: ...
def vertex_metrics() -> list[MetricInfo]: ...
def wilcoxon_test(a: torch.Tensor, b: torch.Tensor) -> PairedTest: ...
