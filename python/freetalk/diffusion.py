"""Noise schedules, and samplers of the reverse process by name: DDIM, DDPM, DPM-Solver++(2M)."""

from __future__ import annotations

from collections.abc import Callable

import torch

from freetalk import _native

Schedule = _native.diffusion.Schedule
ScheduleOptions = _native.diffusion.ScheduleOptions
SamplerOptions = _native.diffusion.SamplerOptions
sampler_timesteps = _native.diffusion.sampler_timesteps

Denoiser = Callable[[torch.Tensor, int], torch.Tensor]


def sample(
    schedule: _native.diffusion.Schedule,
    denoiser: Denoiser,
    *,
    noise: torch.Tensor,
    options: _native.diffusion.SamplerOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """Runs the reverse process.

    Args:
        schedule: of the forward process.
        denoiser: ``denoiser(x, timestep)`` estimates x_0, shaped as x.
        noise: x_T of any shape.
        options: ``sampler`` "ddim" [Song et al. 2021], "ddpm" [Ho et al. 2020], "renoise"
            [FaceTalk Eq. 9] or "dpmpp" [DPM-Solver++(2M), Lu et al. 2022]; ``num_steps``; ``eta`` of DDIM;
            ``spacing`` of the timesteps "trailing", "leading", "linspace", "logsnr" or "auto".
        seed: of the noise that DDPM, renoise and DDIM with eta > 0 add.
        on_step: called with (steps done, steps in all).

    Returns:
        The final estimate of x_0.

    Raises:
        ValueError: an option out of range.
    """
    return _native.diffusion.sample(
        schedule,
        denoiser,
        noise=noise,
        options=options or SamplerOptions(),
        seed=seed,
        on_step=on_step,
    )


__all__ = ["SamplerOptions", "Schedule", "ScheduleOptions", "sample", "sampler_timesteps"]
