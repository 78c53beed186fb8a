from __future__ import annotations
import freetalk._native.geometry
import torch
import typing

__all__: list[str] = [
    "DiffusionNetImpl",
    "DiffusionNetOptions",
    "JacobianFieldImpl",
    "JacobianFieldOptions",
    "PoissonNetImpl",
    "PoissonNetOptions",
    "VertexMlpImpl",
    "VertexMlpOptions",
    "band_mask",
    "face_divergence",
    "face_gradients",
    "integrate_jacobians",
    "poisson_solve",
    "sinusoidal_code",
    "sparse_product",
]

class DiffusionNetOptions:
    """
    Options of DiffusionNet.
    """

    __hash__: typing.ClassVar[None] = None
    diffusion_method: typing.Any
    dropout: typing.Any
    in_channels: typing.Any
    mlp_hidden: typing.Any
    num_blocks: typing.Any
    out_channels: typing.Any
    outputs_at: typing.Any
    width: typing.Any
    with_gradient_features: typing.Any
    with_gradient_rotations: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> DiffusionNetOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: DiffusionNetOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class DiffusionNetImpl:
    def __init__(self, options: DiffusionNetOptions) -> None: ...
    def forward(
        self, x: torch.Tensor, operators: freetalk._native.geometry.SurfaceOperators
    ) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> DiffusionNetOptions: ...
    @property
    def training(self) -> bool: ...

class PoissonNetOptions:
    """
    Options of PoissonNet.
    """

    __hash__: typing.ClassVar[None] = None
    dropout: typing.Any
    gradient_products: typing.Any
    in_channels: typing.Any
    modulate: typing.Any
    num_blocks: typing.Any
    num_complex_layers: typing.Any
    out_channels: typing.Any
    width: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> PoissonNetOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: PoissonNetOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class PoissonNetImpl:
    def __init__(self, options: PoissonNetOptions) -> None: ...
    def forward(
        self, x: torch.Tensor, operators: freetalk._native.geometry.SurfaceOperators
    ) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> PoissonNetOptions: ...
    @property
    def training(self) -> bool: ...

class JacobianFieldOptions:
    """
    Options of JacobianField.
    """

    __hash__: typing.ClassVar[None] = None
    dropout: typing.Any
    in_channels: typing.Any
    num_layers: typing.Any
    translation: typing.Any
    width: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> JacobianFieldOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: JacobianFieldOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class JacobianFieldImpl:
    def __init__(self, options: JacobianFieldOptions) -> None: ...
    def forward(
        self, x: torch.Tensor, operators: freetalk._native.geometry.SurfaceOperators
    ) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> JacobianFieldOptions: ...
    @property
    def training(self) -> bool: ...

class VertexMlpOptions:
    """
    Options of VertexMlp.
    """

    __hash__: typing.ClassVar[None] = None
    dropout: typing.Any
    in_channels: typing.Any
    num_layers: typing.Any
    out_channels: typing.Any
    width: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> VertexMlpOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: VertexMlpOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class VertexMlpImpl:
    def __init__(self, options: VertexMlpOptions) -> None: ...
    def forward(
        self, x: torch.Tensor, operators: freetalk._native.geometry.SurfaceOperators
    ) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> VertexMlpOptions: ...
    @property
    def training(self) -> bool: ...

def band_mask(
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    radius: typing.SupportsInt | typing.SupportsIndex,
) -> torch.Tensor: ...
def face_divergence(
    faces: freetalk._native.geometry.FaceOperators, g: torch.Tensor
) -> torch.Tensor: ...
def face_gradients(
    faces: freetalk._native.geometry.FaceOperators, x: torch.Tensor
) -> torch.Tensor: ...
def integrate_jacobians(
    faces: freetalk._native.geometry.FaceOperators, jacobians: torch.Tensor
) -> torch.Tensor: ...
def poisson_solve(
    faces: freetalk._native.geometry.FaceOperators,
    rhs: torch.Tensor,
    *,
    regularization: typing.SupportsFloat | typing.SupportsIndex = 1e-06,
) -> torch.Tensor: ...
def sinusoidal_code(
    positions: torch.Tensor, dim: typing.SupportsInt | typing.SupportsIndex
) -> torch.Tensor: ...
def sparse_product(
    matrix: freetalk._native.geometry.SparseOperator, x: torch.Tensor
) -> torch.Tensor:
    """
    (B, R, C) products of a SparseOperator (R, V) with x (B, V, C); differentiable in x.
    """
