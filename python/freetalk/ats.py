"""ATS, Audio-To-Sparse: speech features, emotion and intensity to the motion of 68 landmarks."""

from __future__ import annotations

from collections.abc import Callable

import torch

from freetalk import _native
from freetalk._module import NativeModule

AtsOptions = _native.ats.AtsOptions
GenerateOptions = _native.ats.GenerateOptions
parse_emotion = _native.ats.parse_emotion
window_starts = _native.ats.window_starts

NUM_LANDMARKS = 68
MOTION_DIM = 204


class Ats(NativeModule):
    """The transformer denoiser f(x_l, l, A, e, i) -> x_0 [FreeTalk 3.1, Eq. 6-11].

    Args:
        options: an ``AtsOptions``, or its fields by keyword.
    """

    _impl_type = _native.ats.AtsImpl
    _options_type = AtsOptions
    _format = "freetalk-ats"

    def forward(
        self,
        x: torch.Tensor,
        timestep: torch.Tensor,
        *,
        audio: torch.Tensor,
        emotion: torch.Tensor,
        intensity: torch.Tensor,
        valid: torch.Tensor | None = None,
        drop_audio: torch.Tensor | None = None,
        drop_affect: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """The estimate of the clean motion.

        Args:
            x: (B, T, 204) noisy normalised displacements, T <= max_frames.
            timestep: (B,) int64 diffusion step.
            audio: (B, T, C) speech features at the motion's frames.
            emotion: (B, E) convex mixture over ``options.emotions``; one-hot gives the paper's label.
            intensity: (B,) real in [1, num_intensities].
            valid: (B, T) bool, false on padding.
            drop_audio: (B,) bool, true where the audio is replaced by the learned null (guidance).
            drop_affect: (B,) bool, likewise for emotion and intensity.

        Returns:
            (B, T, 204) normalised displacements.

        Raises:
            ValueError: a shape does not fit; the message says which.
        """
        return self._impl.forward(
            x,
            timestep,
            audio=audio,
            emotion=emotion,
            intensity=intensity,
            valid=valid,
            drop_audio=drop_audio,
            drop_affect=drop_affect,
        )

    def normalize(self, motion: torch.Tensor) -> torch.Tensor:
        """Displacements (..., 204) in metres to the normalised space of the diffusion."""
        return self._impl.normalize(motion)

    def denormalize(self, motion: torch.Tensor) -> torch.Tensor:
        """Normalised displacements (..., 204) back to metres."""
        return self._impl.denormalize(motion)

    def set_motion_statistics(self, mean: torch.Tensor, scale: torch.Tensor) -> None:
        """Sets the buffers of the normalisation.

        Args:
            mean: (204,) metres.
            scale: (204,) metres, positive.
        """
        self._impl.set_motion_statistics(mean, scale)


def generate(
    model: Ats,
    features: torch.Tensor,
    *,
    emotion: torch.Tensor,
    intensity: float,
    options: _native.ats.GenerateOptions | None = None,
    seed: int = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """Motion of any length from speech features, by DDIM over overlapping windows denoised together.

    Args:
        model: in eval mode.
        features: (T, C) speech features at ``model.options.fps``.
        emotion: (E,) convex mixture, see ``parse_emotion``.
        intensity: real in [1, num_intensities].
        options: steps, eta, guidance, windows.
        seed: of the noise; the same seed gives the same motion.
        on_step: called with (steps done, steps in all).

    Returns:
        (T, 68, 3) float32 landmark displacements in metres, canonical frame.
    """
    return _native.ats.generate(
        model._impl,
        features,
        emotion=emotion,
        intensity=intensity,
        options=options or GenerateOptions(),
        seed=seed,
        on_step=on_step,
    )


__all__ = [
    "MOTION_DIM",
    "NUM_LANDMARKS",
    "Ats",
    "AtsOptions",
    "GenerateOptions",
    "generate",
    "parse_emotion",
    "window_starts",
]
