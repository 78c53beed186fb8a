"""Sampling of motion with the shipped weights, on real speech."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import freetalk as ft
from freetalk._pretrained import PRETRAINED
from freetalk.ats import (
    Ats,
    GenerateOptions,
    emotion_text,
    emotion_track,
    generate,
    parse_emotion,
    window_starts,
)
from freetalk.corpus import speech_clip
from freetalk.diffusion import SamplerOptions, Schedule, ScheduleOptions, sample, sampler_timesteps
from freetalk.speech import SpeechEncoder, encode_speech

FAST = GenerateOptions(sampler="dpmpp", num_steps=10)


@pytest.fixture(scope="module")
def ats() -> Ats:
    return Ats.from_pretrained(PRETRAINED / "open-small" / "ats").eval()


@pytest.fixture(scope="module")
def features(ats: Ats) -> torch.Tensor:
    """Of 11 s of speech."""
    encoder = SpeechEncoder.from_pretrained(PRETRAINED / "open-small" / "speech")
    samples = torch.from_numpy(np.array(ft.load_audio(speech_clip()).samples))
    with torch.no_grad():
        return encode_speech(encoder, samples, ats.options.fps)


def relative(a: torch.Tensor, b: torch.Tensor) -> float:
    return float((a - b).norm() / b.norm())


def test_motion_equals_ddim_over_the_layers_of_training(ats: Ats, features: torch.Tensor) -> None:
    clip, emotion = features[:100], parse_emotion("happy", ats.options.emotions)
    schedule = Schedule(ScheduleOptions())
    timesteps = sampler_timesteps(schedule, SamplerOptions(num_steps=20))
    x = torch.randn(100, 204, generator=torch.Generator().manual_seed(5))
    with torch.no_grad():
        for i, t in enumerate(timesteps):
            x0 = ats(
                x[None],
                torch.tensor([t]),
                audio=clip[None],
                emotion=emotion[None],
                intensity=torch.tensor([2.0]),
            )[0]
            a = schedule.alpha_bar(t)
            b = schedule.alpha_bar(timesteps[i + 1] if i + 1 < len(timesteps) else -1)
            x = b**0.5 * x0 + (1 - b) ** 0.5 * (x - a**0.5 * x0) / (1 - a) ** 0.5
        expected = ats.denormalize(x).unflatten(-1, (68, 3))
    options = GenerateOptions(num_steps=20)
    motion = generate(ats, clip, emotion=emotion, intensity=2.0, options=options, seed=5)
    # Twenty evaluations in float32 by other kernels.
    assert relative(motion, expected) < 1e-3


@pytest.mark.slow
def test_twenty_steps_of_dpm_solver_equal_a_hundred_of_ddim(
    ats: Ats, features: torch.Tensor
) -> None:
    emotion = parse_emotion("surprise", ats.options.emotions)
    clip = features[:150]

    def motion(**options: object) -> torch.Tensor:
        wanted = GenerateOptions(**options)
        return generate(ats, clip, emotion=emotion, intensity=2.0, options=wanted, seed=1)

    whole = motion(num_steps=100)
    twenty = relative(motion(sampler="dpmpp", num_steps=20), whole)
    assert twenty < 0.02
    assert relative(motion(sampler="dpmpp", num_steps=10), whole) < 0.05
    assert relative(motion(sampler="ddim", num_steps=20), whole) > twenty
    # Eight bits of mantissa, through four layers whose residuals add up.
    assert relative(motion(num_steps=100, precision="bfloat16"), whole) < 0.03


@pytest.mark.slow
def test_no_seam_shows_in_long_motion(ats: Ats, features: torch.Tensor) -> None:
    """Jerk where windows overlap against elsewhere, over groups of windows and single windows."""
    long = features.repeat(5, 1)  # 55 s
    emotion = parse_emotion("neutral", ats.options.emotions)
    starts = window_starts(len(long), ats.options.max_frames, 30)
    seam = torch.zeros(len(long), dtype=torch.bool)
    for before, after in zip(starts, starts[1:], strict=False):
        seam[after : before + ats.options.max_frames] = True
    for windows in (1, 4):
        options = GenerateOptions(sampler="dpmpp", num_steps=10, windows_per_batch=windows)
        motion = generate(ats, long, emotion=emotion, intensity=1.0, options=options, seed=2)
        jerk = motion.diff(n=3, dim=0).norm(dim=-1).mean(dim=-1)
        assert jerk[seam[:-3]].mean() < 1.2 * jerk[~seam[:-3]].mean()


def test_keyframes_lead_from_one_emotion_to_another(ats: Ats, features: torch.Tensor) -> None:
    clip = features[:150]  # 5 s

    def motion(emotion: object) -> torch.Tensor:
        mixtures, levels, weight = emotion_track(
            emotion, ats.options.emotions, num_frames=150, fps=ats.options.fps
        )
        return generate(
            ats, clip, emotion=mixtures, intensity=levels, weight=weight, options=FAST, seed=3
        )

    calm, angry = motion([(0.0, "neutral", 1)]), motion([(0.0, {"angry": 1.0}, 3)])
    changing = motion([(1.5, "neutral", 1), (3.5, "angry", 3)])
    for part, near, far in ((slice(0, 30), calm, angry), (slice(120, 150), angry, calm)):
        # Attention lets a frame see how others move: nearer, not equal.
        away = (changing[part] - near[part]).norm()
        assert away < 0.75 * (changing[part] - far[part]).norm()


@pytest.mark.slow
def test_guidance_moves_away_from_the_unconditional(ats: Ats, features: torch.Tensor) -> None:
    clip, emotion = features[:90], parse_emotion("angry", ats.options.emotions)

    def motion(**options: float) -> torch.Tensor:
        wanted = GenerateOptions(sampler="dpmpp", num_steps=10, **options)
        return generate(ats, clip, emotion=emotion, intensity=3.0, options=wanted, seed=4)

    plain = motion()
    assert torch.equal(motion(audio_guidance=1.0, affect_guidance=1.0), plain)
    for name in ("audio_guidance", "affect_guidance"):
        absent, little, more = (motion(**{name: weight}) for weight in (0.0, 1.25, 1.5))
        toward = plain - absent  # what the condition adds
        for guided in (little, more):
            assert ((guided - plain) * toward).sum() > 0, name
        assert (more - plain).norm() > 1.5 * (little - plain).norm(), name
    both = motion(audio_guidance=1.25, affect_guidance=1.25)
    assert relative(both, motion(audio_guidance=1.25)) > 0.01
    assert relative(both, motion(affect_guidance=1.25)) > 0.01


@pytest.mark.slow
def test_less_noise_brings_the_mouths_of_two_seeds_together(
    ats: Ats, features: torch.Tensor
) -> None:
    clip, emotion = features[:200], parse_emotion("happy", ats.options.emotions)

    def motion(temperature: float, eta: float, seed: object) -> torch.Tensor:
        wanted = GenerateOptions(num_steps=10, eta=eta, mouth_temperature=temperature)
        return generate(ats, clip, emotion=emotion, intensity=2.0, options=wanted, seed=seed)

    brows, mouth = slice(17, 27), slice(48, 68)
    for eta in (0.0, 1.0):
        apart = {}
        for temperature in (0.0, 0.5, 1.0):
            one, other = motion(temperature, eta, [0, 1])
            apart[temperature] = [relative(one[:, p], other[:, p]) for p in (brows, mouth)]
        assert apart[0.0][1] < 0.8 * apart[0.5][1] < 0.8 * 0.9 * apart[1.0][1]
        assert apart[0.0][0] > 0.3 * apart[1.0][0]  # speech hardly determines them
    plain = GenerateOptions(num_steps=10)
    expected = generate(ats, clip, emotion=emotion, intensity=2.0, options=plain, seed=3)
    assert torch.equal(motion(1.0, 0.0, 3), expected)
    with pytest.raises(ValueError, match="mouth_temperature must be between 0 and 1"):
        motion(1.5, 0.0, 0)


@pytest.mark.slow
def test_several_seeds_at_once(ats: Ats, features: torch.Tensor) -> None:
    clip, emotion = features[:200], parse_emotion("happy", ats.options.emotions)

    def motion(seed: object) -> torch.Tensor:
        return generate(ats, clip, emotion=emotion, intensity=2.0, options=FAST, seed=seed)

    together = motion([7, 8, 9])
    assert together.shape == (3, 200, 68, 3)
    assert relative(together[1], motion(8)) < 1e-3  # products of other sizes round differently
    assert relative(together[0], together[1]) > 0.02


def test_emotions_as_text() -> None:
    assert emotion_text("happy") == "happy"
    assert emotion_text({"happy": 0.7, "surprise": 0.3}) == "happy:0.7,surprise:0.3"
    keys = [(0.0, "neutral", 1), (2.5, {"happy": 0.7, "surprise": 0.3}, 2.5), (4, "sad")]
    text = "0.0=neutral@1.0;2.5=happy:0.7,surprise:0.3@2.5;4.0=sad"
    assert emotion_text(keys) == text
    mixtures, levels, weight = emotion_track(
        keys, ["neutral", "happy", "surprise", "sad"], num_frames=4, fps=0.8, intensity=2
    )
    assert mixtures[1].tolist() == pytest.approx([0, 0.7, 0.3, 0])
    assert levels.tolist() == [1, 2.5, 2]
    halves = [[1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 1 / 6, 5 / 6]]  # 0, 1.25, 2.5, 3.75 s
    torch.testing.assert_close(weight, torch.tensor(halves))
    with pytest.raises(ValueError, match="keyframe"):
        emotion_text([(0.0, "neutral", 1, 2)])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="must rise"):
        emotion_track([(1, "sad"), (0, "sad")], ["sad"], num_frames=3, fps=30)


def test_samplers_share_one_interface() -> None:
    """A denoiser that always answers the same is sampled to that answer."""
    schedule = Schedule(ScheduleOptions(kind="cosine"))
    seen: list[tuple[int, int]] = []
    for sampler in ("ddim", "ddpm", "dpmpp"):
        result = sample(
            schedule,
            lambda x, t: torch.full_like(x, 2.0),
            noise=torch.randn(4, generator=torch.Generator().manual_seed(0)),
            options=SamplerOptions(sampler=sampler, num_steps=8),
            on_step=lambda done, total: seen.append((done, total)),
        )
        assert torch.equal(result, torch.full((4,), 2.0))
    assert seen == [(i, 8) for i in range(1, 9)] * 3
    with pytest.raises(ValueError, match="dpmpp"):
        SamplerOptions(sampler="euler")
