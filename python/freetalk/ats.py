"""ATS, Audio-To-Sparse: speech features, emotion and intensity to the motion of 68 landmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import torch
from torch.nn.utils.rnn import pad_sequence

from freetalk import _native, diffusion
from freetalk._module import NativeModule

AtsOptions = _native.ats.AtsOptions
GenerateOptions = _native.ats.GenerateOptions
articulate = _native.ats.articulate
parse_emotion = _native.ats.parse_emotion
window_starts = _native.ats.window_starts

NUM_LANDMARKS: int = _native.core.NUM_LANDMARKS
MOTION_DIM = 3 * NUM_LANDMARKS

Mixture: TypeAlias = "str | Mapping[str, float]"
"""``"happy"``, ``"happy:0.7,surprise:0.3"`` or ``{"happy": 0.7, "surprise": 0.3}``."""
EmotionKey: TypeAlias = "tuple[float, Mixture] | tuple[float, Mixture, float]"
"""(time in seconds, mixture) or (time, mixture, intensity)."""
Emotion: TypeAlias = "Mixture | Sequence[EmotionKey]"


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
        first_position: torch.Tensor | None = None,
        known: torch.Tensor | None = None,
    ) -> torch.Tensor:
        """The estimate of the clean motion.

        Args:
            x: (B, T, 204) noisy normalised displacements, T <= max_frames.
            timestep: (B,) int64 diffusion step.
            audio: (B, T, C) speech features at the motion's frames.
            emotion: (B, E) convex mixture over ``options.emotions``; one-hot gives the paper's label.
                (B, T, E) changes over time.
            intensity: (B,) real in [1, num_intensities]; (B, T) if the emotion changes.
            valid: (B, T) bool, false on padding.
            drop_audio: (B,) bool, true where the audio is replaced by the learned null (guidance).
            drop_affect: (B,) bool, likewise for emotion and intensity.
            first_position: (B,) int64 learned position of each first frame, in
                [0, max_frames - T]; None is 0.
            known: (B,) int64 first frames of ``x`` that are clean, whatever the timestep of the others; None is 0.

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
            first_position=first_position,
            known=known,
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


def emotion_text(emotion: Emotion) -> str:
    """An emotion, a mixture or keyframes as the text that options and the command line take.

    Args:
        emotion: ``"happy"``; ``{"happy": 0.7, "surprise": 0.3}``; or keyframes
            ``[(0.0, "neutral", 1), (2.5, {"happy": 0.7, "surprise": 0.3}, 2.5)]``: time in seconds,
            mixture and, if it differs from the one intensity, an intensity.

    Returns:
        Such as ``"0.0=neutral@1.0;2.5=happy:0.7,surprise:0.3@2.5"``.

    Raises:
        ValueError: a keyframe is not (time, mixture) or (time, mixture, intensity).
    """
    if isinstance(emotion, (str, Mapping)):
        return _mixture_text(emotion)
    keys = []
    for key in emotion:
        if not isinstance(key, Sequence) or isinstance(key, str) or len(key) not in (2, 3):
            raise ValueError(
                f"an emotion keyframe is (seconds, mixture) or (seconds, mixture, intensity), found {key!r}"
            )
        text = f"{float(key[0])!r}={_mixture_text(key[1])}"
        keys.append(text if len(key) == 2 else f"{text}@{float(key[2])!r}")
    return ";".join(keys)


def _mixture_text(mixture: Mixture) -> str:
    if isinstance(mixture, str):
        return mixture
    return ",".join(f"{name}:{float(weight)!r}" for name, weight in mixture.items())


def emotion_track(
    emotion: Emotion,
    emotions: Sequence[str],
    *,
    num_frames: int,
    fps: float,
    intensity: float = 2.0,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The emotions of keyframes, and how much of each a frame feels.

    Args:
        emotion: as :func:`emotion_text` takes it.
        emotions: the model's, ``options.emotions``.
        num_frames: T.
        fps: frames per second.
        intensity: of keyframes that name none.

    Returns:
        (K, E) convex mixtures, (K,) intensities and (T, K) weights, linear from keyframe to keyframe and
        held before and after them, as :func:`generate` takes them.

    Raises:
        ValueError: an unknown emotion, or times that do not rise; the message quotes the part at fault.
    """
    return _native.ats.emotion_track(
        emotion_text(emotion), list(emotions), intensity=intensity, num_frames=num_frames, fps=fps
    )


def generate(
    model: Ats,
    features: torch.Tensor,
    *,
    emotion: torch.Tensor,
    intensity: float | torch.Tensor,
    weight: torch.Tensor | None = None,
    options: _native.ats.GenerateOptions | None = None,
    seed: int | Sequence[int] = 0,
    on_step: Callable[[int, int], None] | None = None,
) -> torch.Tensor:
    """Motion of any length from speech features, by diffusion over overlapping windows denoised together.

    Where the emotion changes, the estimates of x_0 under each emotion are blended frame by frame.

    Args:
        model: in eval mode.
        features: (T, C) speech features at ``model.options.fps``.
        emotion: (E,) convex mixture, see ``parse_emotion``; or (K, E), see ``emotion_track``.
        intensity: real in [1, num_intensities]; (K,) if the emotion is (K, E).
        weight: (T, K) of each emotion in every frame, a frame's sum is one; needed for K > 1.
        options: sampler, steps, guidance, precision, windows.
        seed: of the noise; the same seed gives the same motion, on the CPU bit for bit. K seeds give K motions,
            sampled together.
        on_step: called with (steps done, steps in all).

    Returns:
        (T, 68, 3) float32 landmark displacements in metres, canonical frame; (K, T, 68, 3) for a
        sequence of K seeds.

    Raises:
        ValueError: a shape does not fit, or a value is out of range.
    """
    several = isinstance(seed, Sequence)
    motion = _native.ats.generate(
        model._plain_impl,
        features,
        emotion=emotion if emotion.dim() > 1 else emotion[None],
        intensity=torch.as_tensor(intensity, dtype=features.dtype).reshape(-1),
        weight=weight,
        options=options or GenerateOptions(),
        seeds=[int(one) for one in seed] if isinstance(seed, Sequence) else [int(seed)],
        on_step=on_step,
    )
    return motion if several else motion[0]


def generate_batch(
    model: Ats,
    features: Sequence[torch.Tensor],
    *,
    emotion: torch.Tensor,
    intensity: torch.Tensor,
    options: _native.ats.GenerateOptions | None = None,
    seeds: Sequence[Sequence[int]],
) -> list[torch.Tensor]:
    """Motion of several clips in common passes of the network, for GPUs: equal to :func:`generate` up to rounding.

    Clips longer than the network's window, and samplers that draw noise on the way, go through :func:`generate`
    one by one.

    Args:
        model: in eval mode.
        features: B of (T_b, C), speech features at ``model.options.fps``.
        emotion: (B, E) convex mixtures.
        intensity: (B,) real in [1, num_intensities].
        options: as for :func:`generate`.
        seeds: K a clip, of as many motions.

    Returns:
        B of (K, T_b, 68, 3) float32 landmark displacements in metres, canonical frame.

    Raises:
        ValueError: as :func:`generate`.
    """
    o = options or GenerateOptions()
    window = model.options.trained_frames or model.options.max_frames
    drawing = o.sampler == "ddpm" or (o.sampler == "ddim" and o.eta > 0)
    alone = drawing or len(features) == 1
    short = [b for b, one in enumerate(features) if len(one) <= window and not alone]
    motions = {
        b: generate(
            model, one, emotion=emotion[b], intensity=intensity[b], options=o, seed=list(seeds[b])
        )
        for b, one in enumerate(features)
        if b not in short
    }
    if short:
        kept = torch.tensor(short)
        found = _sample_padded(
            model,
            [features[b] for b in short],
            emotion[kept.to(emotion.device)],
            intensity[kept.to(intensity.device)],
            o,
            [seeds[b] for b in short],
        )
        motions.update(zip(short, found, strict=True))
    return [motions[b] for b in range(len(features))]


@torch.no_grad()
def _sample_padded(
    model: Ats,
    features: Sequence[torch.Tensor],
    emotion: torch.Tensor,
    intensity: torch.Tensor,
    o: _native.ats.GenerateOptions,
    seeds: Sequence[Sequence[int]],
) -> list[torch.Tensor]:
    own, device = model.options, features[0].device
    rows = [(b, seed) for b, some in enumerate(seeds) for seed in some]
    audio = pad_sequence([features[b].float() for b, _ in rows], batch_first=True)
    lengths = torch.tensor([len(features[b]) for b, _ in rows], device=device)
    amount = torch.full((NUM_LANDMARKS, 3), o.mouth_temperature, device=device)
    amount[17:27] = amount[36:48] = 1.0  # brows and eyes, which speech hardly determines
    noise = [
        torch.randn(
            len(features[b]),
            MOTION_DIM,
            generator=torch.Generator(device).manual_seed(seed),
            device=device,
        )
        * amount.flatten()
        for b, seed in rows
    ]
    of_row = torch.tensor([b for b, _ in rows])
    conditions = {
        "audio": audio,
        "emotion": emotion.to(device)[of_row.to(device)].float(),
        "intensity": intensity.to(device)[of_row.to(device)].float(),
        "valid": torch.arange(audio.shape[1], device=device) < lengths[:, None],
    }
    nothing = torch.ones(len(rows), dtype=torch.bool, device=device)
    extra = {"drop_audio": o.audio_guidance - 1, "drop_affect": o.affect_guidance - 1}

    def denoise(x: torch.Tensor, timestep: int) -> torch.Tensor:
        step = torch.full((len(rows),), timestep, device=device)
        with torch.autocast(device.type, torch.bfloat16, enabled=o.precision == "bfloat16"):
            estimate = (1 + sum(extra.values())) * model(x, step, **conditions).float()
            for name, weight in extra.items():
                if weight != 0:
                    dropped = model(x, step, **conditions, **{name: nothing}).float()
                    estimate = estimate - weight * dropped
        return estimate

    schedule = diffusion.Schedule(
        diffusion.ScheduleOptions(
            kind=own.schedule,
            num_steps=own.num_train_steps,
            beta_start=own.beta_start,
            beta_end=own.beta_end,
        )
    )
    sampling = diffusion.SamplerOptions(
        sampler=o.sampler, num_steps=o.num_steps, eta=o.eta, spacing=o.spacing
    )
    padded = pad_sequence(noise, batch_first=True)
    motion = model.denormalize(diffusion.sample(schedule, denoise, noise=padded, options=sampling))
    motion = articulate(motion.float().unflatten(2, (NUM_LANDMARKS, 3)), o.articulation)
    ends = torch.tensor([len(some) for some in seeds]).cumsum(0).tolist()
    return [
        motion[end - len(some) : end, : len(one)]
        for end, some, one in zip(ends, seeds, features, strict=True)
    ]


__all__ = [
    "MOTION_DIM",
    "NUM_LANDMARKS",
    "Ats",
    "AtsOptions",
    "GenerateOptions",
    "articulate",
    "emotion_text",
    "emotion_track",
    "generate",
    "generate_batch",
    "parse_emotion",
    "window_starts",
]
