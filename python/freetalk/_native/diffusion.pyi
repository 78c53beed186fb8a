from __future__ import annotations
import collections.abc
import torch
import typing

__all__: list[str] = [
    "SamplerOptions",
    "Schedule",
    "ScheduleOptions",
    "sample",
    "sampler_timesteps",
]

class ScheduleOptions:
    """
    Noise schedule: kind, num_steps, betas.
    """

    __hash__: typing.ClassVar[None] = None
    beta_end: typing.Any
    beta_start: typing.Any
    kind: typing.Any
    num_steps: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> ScheduleOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: ScheduleOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Schedule:
    """
    Noise schedule and forward process [FreeTalk Eq. 4-5].
    """
    def __init__(self, options: ScheduleOptions = ...) -> None: ...
    def alpha_bar(self, timestep: typing.SupportsInt | typing.SupportsIndex) -> float: ...
    def q_sample(
        self, x0: torch.Tensor, timestep: torch.Tensor, *, noise: torch.Tensor
    ) -> torch.Tensor:
        """
        Noisy x_l of x0 (B, ...) at timestep (B,) int64 with the given noise [FreeTalk Eq. 5].
        """
    @property
    def alphas_cumprod(self) -> torch.Tensor: ...
    @property
    def options(self) -> ScheduleOptions: ...

class SamplerOptions:
    """
    Reverse process: sampler, num_steps, eta, spacing.
    """

    __hash__: typing.ClassVar[None] = None
    eta: typing.Any
    num_steps: typing.Any
    sampler: typing.Any
    spacing: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SamplerOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SamplerOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

def sample(
    schedule: Schedule,
    denoiser: collections.abc.Callable[[torch.Tensor, int], torch.Tensor],
    *,
    noise: torch.Tensor,
    options: SamplerOptions = ...,
    seed: typing.SupportsInt | typing.SupportsIndex = 0,
    on_step: collections.abc.Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """
    Reverse process from noise with denoiser(x, timestep) -> x0; seed: of the noise that stochastic samplers add.
    """

def sampler_timesteps(schedule: Schedule, options: SamplerOptions) -> list[int]:
    """
    The timesteps that a sampler visits, falling.
    """
