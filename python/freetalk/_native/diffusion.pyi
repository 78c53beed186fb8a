from __future__ import annotations
import torch
import typing

__all__: list[str] = ["DdimOptions", "Schedule", "ScheduleOptions", "ddim_sample", "ddim_timesteps"]

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

class DdimOptions:
    """
    DDIM: num_steps, eta, spacing.
    """

    __hash__: typing.ClassVar[None] = None
    eta: typing.Any
    num_steps: typing.Any
    spacing: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> DdimOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: DdimOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

def ddim_sample(
    schedule: Schedule,
    denoiser: ...,
    *,
    noise: torch.Tensor,
    options: DdimOptions = ...,
    seed: typing.SupportsInt | typing.SupportsIndex = 0,
) -> torch.Tensor:
    """
    DDIM from noise with denoiser(x, timestep) -> x0 [Song et al. 2021]; seed: of the noise that eta > 0 adds.
    """

def ddim_timesteps(
    num_train_steps: typing.SupportsInt | typing.SupportsIndex, options: DdimOptions
) -> list[int]: ...
