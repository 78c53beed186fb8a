"""Noise schedules and samplers."""

from __future__ import annotations

from freetalk import _native

Schedule = _native.diffusion.Schedule
ScheduleOptions = _native.diffusion.ScheduleOptions
DdimOptions = _native.diffusion.DdimOptions
ddim_sample = _native.diffusion.ddim_sample
ddim_timesteps = _native.diffusion.ddim_timesteps

__all__ = ["DdimOptions", "Schedule", "ScheduleOptions", "ddim_sample", "ddim_timesteps"]
