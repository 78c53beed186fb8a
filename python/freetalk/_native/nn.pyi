from __future__ import annotations
import freetalk._native.geometry
import torch
import typing

__all__: list[str] = [
    "DiffusionNetImpl",
    "DiffusionNetOptions",
    "band_mask",
    "landmark_adjacency",
    "landmark_edges",
    "landmark_mirror",
    "sinusoidal_code",
    "sparse_product",
]

class DiffusionNetOptions:
    """
    Options of DiffusionNet.
    """

    __hash__: typing.ClassVar[None] = None
    dropout: typing.Any
    in_channels: typing.Any
    num_blocks: typing.Any
    out_channels: typing.Any
    width: typing.Any
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

def band_mask(
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    radius: typing.SupportsInt | typing.SupportsIndex,
) -> torch.Tensor: ...
def landmark_adjacency() -> torch.Tensor: ...
def landmark_edges() -> list[tuple[int, int]]: ...
def landmark_mirror() -> typing.Annotated[list[int], "FixedSize(68)"]: ...
def sinusoidal_code(
    positions: torch.Tensor, dim: typing.SupportsInt | typing.SupportsIndex
) -> torch.Tensor: ...
def sparse_product(
    matrix: torch.Tensor, transposed: torch.Tensor, x: torch.Tensor
) -> torch.Tensor: ...
