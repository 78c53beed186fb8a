from __future__ import annotations
import collections.abc
import torch
import typing

__all__: list[str] = [
    "CodeStream",
    "FaceTalkImpl",
    "FaceTalkOptions",
    "GenerateOptions",
    "generate",
]

class FaceTalkOptions:
    """
    Options of the FaceTalk denoiser [FaceTalk Sec. 4].
    """

    __hash__: typing.ClassVar[None] = None
    activation: typing.Any
    align_audio: typing.Any
    audio_dim: typing.Any
    beta_end: typing.Any
    beta_start: typing.Any
    code_dim: typing.Any
    codes: typing.Any
    condition: typing.Any
    d_model: typing.Any
    diffusion: typing.Any
    dropout: typing.Any
    expressions: typing.Any
    feature_resampling: typing.Any
    ff_dim: typing.Any
    film_form: typing.Any
    fps: typing.Any
    head: typing.Any
    max_frames: typing.Any
    norm_first: typing.Any
    num_heads: typing.Any
    num_layers: typing.Any
    num_train_steps: typing.Any
    positions: typing.Any
    schedule: typing.Any
    time_condition: typing.Any
    time_layers: typing.Any
    window: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> FaceTalkOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: FaceTalkOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class FaceTalkImpl:
    def __init__(self, options: FaceTalkOptions) -> None: ...
    def denormalize(self, codes: torch.Tensor) -> torch.Tensor: ...
    def forward(
        self,
        x: torch.Tensor,
        timestep: torch.Tensor,
        *,
        audio: torch.Tensor,
        drop_audio: torch.Tensor | None = None,
        valid: torch.Tensor | None = None,
    ) -> torch.Tensor: ...
    def landmarks(self, codes: torch.Tensor) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def normalize(self, codes: torch.Tensor) -> torch.Tensor: ...
    def set_code_statistics(
        self,
        *,
        mean: torch.Tensor,
        scale: torch.Tensor,
        rest: torch.Tensor,
        landmark_basis: torch.Tensor,
    ) -> None: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> FaceTalkOptions: ...
    @property
    def training(self) -> bool: ...

class GenerateOptions:
    """
    Sampling of expression codes.
    """

    __hash__: typing.ClassVar[None] = None
    audio_guidance: typing.Any
    eta: typing.Any
    num_steps: typing.Any
    piece_frames: typing.Any
    precision: typing.Any
    sampler: typing.Any
    spacing: typing.Any
    temperature: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> GenerateOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: GenerateOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class CodeStream:
    """
    Codes while the speech is being heard.
    """
    def __init__(
        self,
        model: FaceTalkImpl,
        *,
        seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        options: GenerateOptions = ...,
    ) -> None: ...
    def num_held(self) -> int: ...
    def push(self, features: torch.Tensor) -> torch.Tensor: ...
    def reset(self) -> None: ...

def generate(
    model: FaceTalkImpl,
    features: torch.Tensor,
    *,
    options: GenerateOptions = ...,
    seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    on_step: collections.abc.Callable[[int, int], None] | None = None,
) -> torch.Tensor: ...
