#!/usr/bin/env python3
"""Times the sampling of landmark motion against the same network as a plain ``torch.nn.TransformerDecoder``.

Both have the paper's size and the same weights, start from the same noise and are timed in turns within one
run; medians are printed, and ratios to the decoder in the same precision. The decoder's side projects the
speech features once, as anyone would, and leaves the rest to PyTorch. Run on an idle machine (on a busy one
OMP_WAIT_POLICY=passive makes the ratio of processor times tell):

    python scripts/bench/ats.py                 # speed, float32 and bfloat16, and DPM-Solver++
    python scripts/bench/ats.py --part quality  # DPM-Solver++ against 100 DDIM steps, shipped weights
    python scripts/bench/ats.py --part long     # ten minutes of speech: memory, seams
"""

from __future__ import annotations

import argparse
import copy
import math
import resource
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import nn

from freetalk import load_audio
from freetalk._pretrained import PRETRAINED as FOLDER
from freetalk.ats import Ats, GenerateOptions, generate, parse_emotion, window_starts
from freetalk.corpus import assets
from freetalk.diffusion import SamplerOptions, Schedule, sampler_timesteps
from freetalk.nn import sinusoidal_code
from freetalk.speech import SpeechEncoder, encode_speech

PRETRAINED = "open-small"


class PlainSampler:
    """DDIM over ``torch.nn.TransformerDecoder``, with the weights of an Ats.

    Args:
        ats: post-norm, in eval mode.
        dtype: of the network.
    """

    def __init__(self, ats: Ats, dtype: torch.dtype) -> None:
        o = ats.options
        layer = nn.TransformerDecoderLayer(
            o.d_model, o.num_heads, o.ff_dim, o.dropout, o.activation, batch_first=True
        )
        self.ats, self.dtype = ats, dtype
        self.state = {name: value.detach() for name, value in ats.state_dict().items()}
        decoder = nn.TransformerDecoder(layer, o.num_layers)
        weights = {k: v.clone() for k, v in self.state.items() if k.startswith("layers.")}
        decoder.load_state_dict(weights)
        self.decoder = decoder.to(dtype).eval()

    def _linear(self, name: str, x: torch.Tensor) -> torch.Tensor:
        weight, bias = self.state[f"{name}.weight"], self.state[f"{name}.bias"]
        return nn.functional.linear(x, weight.to(x.dtype), bias.to(x.dtype))

    def __call__(
        self, features: torch.Tensor, emotion: torch.Tensor, level: int, seed: int, steps: int
    ) -> torch.Tensor:
        """Motion (T, 68, 3) in metres."""
        s, o, frames = self.state, self.ats.options, len(features)
        felt = torch.cat(
            [
                emotion @ s["emotion_embedding.weight"],
                s["intensity_embedding.weight"][level - 1],
            ]
        )
        felt = self._linear("affect_out", nn.functional.silu(self._linear("affect_in", felt)))
        memory = self._linear("memory_proj", features) + s["memory_positions"][:frames]
        memory = memory[None].to(self.dtype)
        index = torch.arange(frames)
        outside = (index[:, None] - index).abs() > o.band_radius
        schedule = Schedule()
        timesteps = sampler_timesteps(schedule, SamplerOptions(num_steps=steps))
        x = torch.randn(frames, 204, generator=torch.Generator().manual_seed(seed))
        for i, t in enumerate(timesteps):
            code = sinusoidal_code(torch.tensor([t]), o.d_model)[0]
            code = self._linear("time_out", nn.functional.silu(self._linear("time_in", code)))
            z = self._linear("input_proj", x) + s["target_positions"][:frames] + code + felt
            z = self.decoder(z[None].to(self.dtype), memory, memory_mask=outside)[0]
            x0 = self._linear("output_proj", z).float()
            a = schedule.alpha_bar(t)
            b = schedule.alpha_bar(timesteps[i + 1] if i + 1 < steps else -1)
            noise = (x - math.sqrt(a) * x0) / math.sqrt(1 - a)
            x = math.sqrt(b) * x0 + math.sqrt(1 - b) * noise
        return self.ats.denormalize(x).unflatten(-1, (68, 3))


def paper_ats(frames: int) -> Ats:
    """An Ats of the paper's size with random weights."""
    torch.manual_seed(0)
    ats = Ats(max_frames=frames)
    with torch.no_grad():
        for name, parameter in ats.named_parameters():
            if name.endswith("bias") or "null" in name:
                parameter.normal_(0, 0.05)  # zero by default: a bias left out would go unseen
    return ats.eval()


def speed(frames: int, repetitions: int, steps: int) -> None:
    """Prints medians, ratios and differences, and every run as it ends."""
    ats = paper_ats(frames)
    features = torch.randn(frames, 768, generator=torch.Generator().manual_seed(1))
    emotion = parse_emotion("happy", ats.options.emotions)

    def ours(**options: object) -> torch.Tensor:
        wanted = GenerateOptions(**{"num_steps": steps, **options})
        return generate(ats, features, emotion=emotion, intensity=2.0, options=wanted, seed=3)

    fewer = {"sampler": "dpmpp", "num_steps": max(1, steps // 5)}
    plain = PlainSampler(copy.deepcopy(ats), torch.float32)
    plain_bf16 = PlainSampler(copy.deepcopy(ats), torch.bfloat16)
    runs: dict[str, Callable[[], torch.Tensor]] = {
        "torch.nn.TransformerDecoder, DDIM": lambda: plain(features, emotion, 2, 3, steps),
        "freetalk, DDIM": ours,
        "torch.nn.TransformerDecoder, bf16": lambda: plain_bf16(features, emotion, 2, 3, steps),
        "freetalk, bf16": lambda: ours(precision="bfloat16"),
        "freetalk, DPM-Solver++": lambda: ours(**fewer),
        "freetalk, DPM-Solver++, bf16": lambda: ours(**fewer, precision="bfloat16"),
    }
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    busy: dict[str, list[float]] = {name: [] for name in runs}
    motions: dict[str, torch.Tensor] = {}
    with torch.no_grad():
        for _ in range(repetitions):
            for name, run in runs.items():
                start, start_busy = time.perf_counter(), time.process_time()
                motions[name] = run()
                seconds[name].append(time.perf_counter() - start)
                busy[name].append(time.process_time() - start_busy)
                print(f"  {name:<40} {seconds[name][-1]:7.2f} s", flush=True)
    names = list(runs)
    float_name, bf16_name = names[0], names[2]
    print(f"{frames} frames, {torch.get_num_threads()} threads, median of {repetitions}")
    print(f"{steps} steps of DDIM, {fewer['num_steps']} of DPM-Solver++")
    for name in names:
        public = bf16_name if name.endswith("bf16") else float_name
        ratio, busy_ratio = (
            statistics.median(of[public]) / statistics.median(of[name]) for of in (seconds, busy)
        )
        difference = (motions[name] - motions[names[0]]).abs().max()
        scale = motions[names[0]].abs().max()
        print(
            f"{name:<40} {statistics.median(seconds[name]):7.2f} s  {ratio:6.2f} x  (of processor "
            f"time {busy_ratio:6.2f} x)  largest difference {difference:.1e} of {scale:.2f}"
        )


def shipped() -> tuple[Ats, SpeechEncoder]:
    """The shipped weights."""
    ats = Ats.from_pretrained(FOLDER / PRETRAINED / "ats").eval()
    return ats, SpeechEncoder.from_pretrained(FOLDER / PRETRAINED / "speech").eval()


def recorded_speech(minutes: float) -> np.ndarray:
    """Captured speech (S,) at 16 kHz: the takes that ship, one after the other, again if they are short."""
    takes = [assets.load_take(name).audio for name in assets.TEST_TAKES + assets.TRAIN_TAKES]
    whole = np.concatenate(takes)
    samples = round(minutes * 60 * 16000)
    return np.tile(whole, math.ceil(samples / len(whole)))[:samples]


def quality() -> None:
    """Prints how far fewer steps are from 100 DDIM steps, relative to the motion."""
    ats, encoder = shipped()
    clip = np.array(load_audio(assets.speech_clip()).samples)
    features = encode_speech(encoder, clip, ats.options.fps)
    emotion = parse_emotion("happy", ats.options.emotions)

    def motion(seed: int, **options: object) -> torch.Tensor:
        wanted = GenerateOptions(**options)
        return generate(ats, features, emotion=emotion, intensity=2.0, options=wanted, seed=seed)

    print(f"{len(features)} frames of speech, shipped weights, seeds 0 to 2")
    for options in (
        {"sampler": "dpmpp", "num_steps": 10},
        {"sampler": "dpmpp", "num_steps": 15},
        {"sampler": "dpmpp", "num_steps": 20},
        {"sampler": "dpmpp", "num_steps": 20, "spacing": "trailing"},
        {"sampler": "ddim", "num_steps": 20},
        {"precision": "bfloat16"},
    ):
        errors = []
        for seed in range(3):
            whole = motion(seed)
            errors.append(float((motion(seed, **options) - whole).norm() / whole.norm()))
        print(f"{options}: {100 * max(errors):.2f} % of the motion")


def long(minutes: float) -> None:
    """Prints time, growth of memory from sound to motion, and jerk at the seams against elsewhere."""
    ats, encoder = shipped()
    fps = ats.options.fps
    speech = recorded_speech(minutes)
    options = GenerateOptions(sampler="dpmpp", num_steps=20)
    emotion = parse_emotion("happy", ats.options.emotions)

    def run(wave: np.ndarray) -> tuple[torch.Tensor, list[float], float]:
        clock = [time.perf_counter()]
        features = encode_speech(encoder, wave, fps)
        clock.append(time.perf_counter())
        motion = generate(ats, features, emotion=emotion, intensity=2.0, options=options)
        clock.append(time.perf_counter())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        return motion, list(np.diff(clock)), peak

    _, _, short_peak = run(speech[: 60 * 16000])
    motion, seconds, peak = run(speech)
    features = len(motion) * ats.options.audio_dim * 4 / 2**20
    result = motion.numel() * motion.element_size() / 2**20
    print(
        f"{minutes:g} minutes: speech encoded in {seconds[0]:.1f} s, motion in {seconds[1]:.1f} s with {options}"
    )
    print(
        f"memory: {peak - short_peak:.0f} MiB above that of one minute; the sound has "
        f"{speech.nbytes / 2**20:.0f} MiB, its features {features:.0f} MiB, noise and motion {3 * result:.0f} MiB"
    )
    at_seams, elsewhere = seam_jerk(motion, ats.options.max_frames, options)
    print(f"jerk at seams {at_seams / elsewhere:.3f} times that elsewhere")


def seam_jerk(motion: torch.Tensor, window: int, options: GenerateOptions) -> tuple[float, float]:
    """Mean jerk (third difference) over the overlaps of windows, and over all other frames."""
    starts = window_starts(len(motion), window, options.window_overlap)
    jerk = motion.diff(n=3, dim=0).norm(dim=-1).mean(dim=-1)  # (T - 3,)
    seam = torch.zeros(len(motion), dtype=torch.bool)
    for before, after in zip(starts, starts[1:], strict=False):
        seam[after : before + window] = True
    seam = seam[:-3]
    return float(jerk[seam].mean()), float(jerk[~seam].mean())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Benchmark of the sampling of motion.")
    parser.add_argument("--part", choices=("speed", "quality", "long"), default="speed")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--steps", type=int, default=100, help="of DDIM; a fifth of DPM-Solver++")
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repetitions", type=int, default=5)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    if arguments.part == "speed":
        speed(arguments.frames, arguments.repetitions, arguments.steps)
    elif arguments.part == "quality":
        quality()
    else:
        long(arguments.minutes)


if __name__ == "__main__":
    main()
