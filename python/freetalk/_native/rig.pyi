from __future__ import annotations
import collections.abc
import os
import torch
import typing

__all__: list[str] = ["FaceRig", "RigOptions", "RigPoses", "SolveState"]

class RigOptions:
    """
    How a rig is made.
    """

    __hash__: typing.ClassVar[None] = None
    cancel: typing.Any
    disabled: typing.Any
    l1: typing.Any
    l2: typing.Any
    max_correctives: typing.Any
    num_poses: typing.Any
    symmetry: typing.Any
    temporal: typing.Any
    tolerance_mm: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> RigOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: RigOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class RigPoses:
    """
    Landmark motion that rigs are made of.
    """
    @staticmethod
    def load(path: os.PathLike | str | bytes) -> RigPoses: ...
    def __init__(
        self, names: collections.abc.Sequence[str], shapes: torch.Tensor, *, library: torch.Tensor
    ) -> None: ...
    @property
    def library(self) -> torch.Tensor: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def shapes(self) -> torch.Tensor: ...

class SolveState:
    """
    What a stream carries from frame to frame.
    """
    def __init__(self) -> None: ...
    @property
    def shapes(self) -> list[float]: ...

class FaceRig:
    """
    A face as named targets and correctives.
    """
    @staticmethod
    def build(
        decode: collections.abc.Callable[[torch.Tensor], torch.Tensor],
        poses: RigPoses,
        *,
        options: RigOptions = ...,
        progress: collections.abc.Callable[[float], None] | None = None,
    ) -> FaceRig: ...
    @staticmethod
    def cached(
        content: str,
        cache_dir: os.PathLike | str | bytes,
        *,
        decode: collections.abc.Callable[[torch.Tensor], torch.Tensor],
        poses: RigPoses,
        options: RigOptions = ...,
        progress: collections.abc.Callable[[float], None] | None = None,
    ) -> FaceRig: ...
    @staticmethod
    def load(path: os.PathLike | str | bytes) -> FaceRig: ...
    def save(self, path: os.PathLike | str | bytes) -> None: ...
    def solve(self, landmarks: torch.Tensor, state: SolveState | None = None) -> torch.Tensor: ...
    def vertices(self, weights: torch.Tensor) -> torch.Tensor: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def num_shapes(self) -> int: ...
    @property
    def num_vertices(self) -> int: ...
    @property
    def options(self) -> RigOptions: ...
    @property
    def targets(self) -> torch.Tensor: ...
