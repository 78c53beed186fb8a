from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import torch
import typing

__all__: list[str] = [
    "Fit",
    "FitOptions",
    "HeadOptions",
    "ParametricHeadImpl",
    "PreparedHead",
    "PreparedOptions",
    "SmoothingOptions",
    "Surface",
    "SurfaceExtractor",
    "SurfaceOptions",
    "TrackOptions",
    "canonical_template",
    "fit_expressions",
    "fit_identity",
    "nphm_paper_options",
    "nphm_small_options",
    "smoothing_weights",
    "track",
]

class HeadOptions:
    """
    Options of a neural parametric head.
    """

    __hash__: typing.ClassVar[None] = None
    anchor_hidden: typing.Any
    background: typing.Any
    box_max: typing.Any
    box_min: typing.Any
    deformation_hidden: typing.Any
    deformation_layers: typing.Any
    direction: typing.Any
    expression_dim: typing.Any
    expression_map_hidden: typing.Any
    expressions: typing.Any
    global_dim: typing.Any
    hyper_dim: typing.Any
    identity_code_dim: typing.Any
    identity_hidden: typing.Any
    identity_layers: typing.Any
    identity_noise: typing.Any
    identity_sees: typing.Any
    kernel_width: typing.Any
    local_dim: typing.Any
    min_weight: typing.Any
    normalizer_eps: typing.Any
    num_anchors: typing.Any
    num_coefficients: typing.Any
    num_pairs: typing.Any
    num_weights: typing.Any
    units_per_metre: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> HeadOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: HeadOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class ParametricHeadImpl:
    def __init__(self, options: HeadOptions) -> None: ...
    def anchors(self, z_id: torch.Tensor) -> torch.Tensor: ...
    def canonical_sdf(
        self,
        points: torch.Tensor,
        z_id: torch.Tensor,
        *,
        z_exp: torch.Tensor | None = None,
        hyper: torch.Tensor | None = None,
    ) -> torch.Tensor: ...
    def expression_code(self, weights: torch.Tensor) -> torch.Tensor: ...
    def forward(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> torch.Tensor: ...
    def identity_code(self, coefficients: torch.Tensor) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def sample_identity(
        self,
        count: typing.SupportsInt | typing.SupportsIndex,
        *,
        seed: typing.SupportsInt | typing.SupportsIndex,
    ) -> torch.Tensor: ...
    def symmetry_distance(self, z_id: torch.Tensor) -> torch.Tensor: ...
    def to_canonical(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor | None]: ...
    def to_posed(
        self, points: torch.Tensor, z_id: torch.Tensor, z_exp: torch.Tensor
    ) -> torch.Tensor: ...
    def train(self, mode: bool) -> None: ...
    @property
    def identity_dim(self) -> int: ...
    @property
    def options(self) -> HeadOptions: ...
    @property
    def training(self) -> bool: ...

class PreparedOptions:
    """
    How a head is made ready for inference.
    """

    __hash__: typing.ClassVar[None] = None
    precision: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> PreparedOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: PreparedOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class PreparedHead:
    def __init__(
        self, head: ParametricHeadImpl, z_id: torch.Tensor, options: PreparedOptions
    ) -> None: ...
    def canonical_sdf(
        self,
        points: torch.Tensor,
        *,
        z_exp: torch.Tensor | None = None,
        hyper: torch.Tensor | None = None,
        fade: bool = True,
    ) -> torch.Tensor: ...
    def sdf(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor: ...
    def to_canonical(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor: ...
    def to_posed(self, points: torch.Tensor, z_exp: torch.Tensor) -> torch.Tensor: ...
    @property
    def anchors(self) -> torch.Tensor: ...

class SmoothingOptions:
    """
    Facial smoothing [FaceTalk Eq. 11-15].
    """

    __hash__: typing.ClassVar[None] = None
    center: typing.Any
    falloff: typing.Any
    mode: typing.Any
    sigma: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SmoothingOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SmoothingOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class SurfaceOptions:
    """
    Extraction of a head's surface.
    """

    __hash__: typing.ClassVar[None] = None
    at_box: typing.Any
    canonical_grid: typing.Any
    coarse: typing.Any
    resolution: typing.Any
    safety: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SurfaceOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SurfaceOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Surface:
    @property
    def faces(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"]: ...
    @property
    def num_evaluations(self) -> int: ...
    @property
    def vertices(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...

class SurfaceExtractor:
    def __init__(
        self, head: PreparedHead, options: SurfaceOptions, smoothing: SmoothingOptions
    ) -> None: ...
    def extract(self, z_exp: torch.Tensor) -> Surface: ...
    def next(self, z_exp: torch.Tensor) -> Surface: ...

class TrackOptions:
    """
    A head as a mesh of fixed topology.
    """

    __hash__: typing.ClassVar[None] = None
    largest_step_mm: typing.Any
    newton_steps: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> TrackOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: TrackOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class FitOptions:
    """
    Fitting of codes to points of a surface.
    """

    __hash__: typing.ClassVar[None] = None
    adam_decay: typing.Any
    adam_iterations: typing.Any
    adam_points: typing.Any
    huber_mm: typing.Any
    iterations: typing.Any
    lambda_reg: typing.Any
    lambda_sdf: typing.Any
    lambda_temp: typing.Any
    learning_rate: typing.Any
    method: typing.Any
    overlap: typing.Any
    points: typing.Any
    prior: typing.Any
    sigma_mm: typing.Any
    temporal: typing.Any
    tolerance_mm: typing.Any
    window: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> FitOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: FitOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Fit:
    @property
    def error_mm(self) -> torch.Tensor: ...
    @property
    def z_exp(self) -> torch.Tensor: ...
    @property
    def z_id(self) -> torch.Tensor: ...

def canonical_template(
    head: PreparedHead, vertices: torch.Tensor, z_exp: torch.Tensor | None = None
) -> torch.Tensor: ...
def fit_expressions(
    head: ParametricHeadImpl,
    z_id: torch.Tensor,
    points: collections.abc.Sequence[torch.Tensor],
    *,
    prior: torch.Tensor | None = None,
    options: FitOptions,
    seed: typing.SupportsInt | typing.SupportsIndex,
    on_step: collections.abc.Callable[[int, int], None] | None = None,
) -> Fit: ...
def fit_identity(
    head: ParametricHeadImpl,
    points: collections.abc.Sequence[torch.Tensor],
    *,
    prior: torch.Tensor | None = None,
    identity_prior: torch.Tensor | None = None,
    options: FitOptions,
    seed: typing.SupportsInt | typing.SupportsIndex,
    on_step: collections.abc.Callable[[int, int], None] | None = None,
) -> Fit: ...
def nphm_paper_options() -> HeadOptions:
    """
    Options of the published NPHM.
    """

def nphm_small_options() -> HeadOptions:
    """
    Options of the head that ships.
    """

def smoothing_weights(
    head: PreparedHead, points: torch.Tensor, options: SmoothingOptions
) -> torch.Tensor:
    """
    w of Eq. 14 at points (N, 3) in head units: (N,).
    """

def track(
    head: PreparedHead,
    template_points: torch.Tensor,
    z_exp: torch.Tensor,
    *,
    refined: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    options: TrackOptions,
    smoothing: SmoothingOptions,
    on_frame: collections.abc.Callable[[int, int], None] | None = None,
) -> torch.Tensor: ...
