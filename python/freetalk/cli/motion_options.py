"""Options that say how motion is made, and where. Imports nothing heavy."""

from __future__ import annotations

import argparse
import math

from freetalk.cli.numbers import articulation, natural, seed, temperature, tolerance

DEFAULT_WEIGHTS = "open-small"
_GUIDANCE = {"audio": "audio_guidance", "emotion": "affect_guidance"}


def guidance(text: str) -> dict[str, float]:
    """A weight for both conditions, or 'audio=W,emotion=W', as options of the talker."""
    pairs = [part.split("=") for part in text.split(",")]
    if len(pairs) == 1 and len(pairs[0]) == 1:
        pairs = [[name, text] for name in _GUIDANCE]
    found: dict[str, float] = {}
    for pair in pairs:
        try:
            name, weight = _GUIDANCE[pair[0].strip()], float(pair[1])
        except (KeyError, IndexError, ValueError):
            name, weight = "", math.nan
        if len(pair) != 2 or not 0 <= weight <= 100 or name in found:
            raise argparse.ArgumentTypeError(
                f"'{text}' is no guidance: give a weight from 0 to 100, such as 1.5, or "
                "'audio=1.5,emotion=2'; 1 is off"
            )
        found[name] = weight
    return found


def add_diffusion(parser: argparse.ArgumentParser) -> None:
    """Adds how motion is sampled from speech; what is not given is as the weights say."""
    absent = argparse.SUPPRESS
    samplers = ("ddim", "ddpm", "renoise", "dpmpp")
    sampler_help = "by default that of the weights: dpmpp (DPM-Solver++) of the shipped ones"
    parser.add_argument("--sampler", choices=samplers, default=absent, help=sampler_help)
    steps_help = "denoising steps; fewer are faster; by default those of the weights, of another sampler 20 (dpmpp) or 50"
    parser.add_argument("--steps", type=natural, default=absent, metavar="N", help=steps_help)
    guidance_help = (
        "how much more than usual the face follows speech and emotion: a weight for both, or "
        "'audio=1.5,emotion=2'; 1 is off, and faster; by default that of the weights"
    )
    parser.add_argument(
        "--guidance", type=guidance, default=absent, metavar="W", help=guidance_help
    )
    temperature_help = (
        "from 0 to 1: how much the mouth's motion varies from seed to seed; less is closer to the "
        "speech; by default that of the weights"
    )
    parser.add_argument(
        "--mouth-temperature", type=temperature, default=absent, metavar="T", help=temperature_help
    )


def diffusion_options(arguments: argparse.Namespace) -> dict[str, object]:
    """What was given of :func:`add_diffusion`, by the names of the library's options."""
    names = {"sampler": "sampler", "steps": "num_steps", "mouth_temperature": "mouth_temperature"}
    given = vars(arguments)
    found = {field: given[name] for name, field in names.items() if name in given}
    return {**found, **given.get("guidance", {})}


def add_performance(parser: argparse.ArgumentParser) -> None:
    """Adds what animating a recording and live speech have in common."""
    parser.add_argument("--seed", type=seed, default=0, help="another seed, another performance")
    parser.add_argument(
        "--articulation",
        type=articulation,
        default=1.0,
        metavar="A",
        help="from 0.5 (mumbled) to 1.5 (exaggerated): how far the mouth goes; lips that close still do",
    )
    parser.add_argument(
        "--blinks",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="also blink where the model leaves the eyes open for long",
    )


def add_decoding(parser: argparse.ArgumentParser) -> None:
    """Adds how ``freetalk animate`` decodes and completes the motion."""
    parser.add_argument(
        "--head-motion",
        action="store_true",
        help="small motion of the head, that goes with the voice: a transform of its own in every format",
    )
    tolerance_help = (
        "largest error in mm of frames that are interpolated instead of decoded by the network; 0 decodes "
        "every frame; by default 0.2"
    )
    parser.add_argument(
        "--tolerance-mm",
        type=tolerance,
        default=argparse.SUPPRESS,
        metavar="MM",
        help=tolerance_help,
    )
    motion_help = (
        "what makes the motion: ats, or facetalk where the weights hold it, which knows no emotions"
    )
    parser.add_argument("--motion", choices=("ats", "facetalk"), default="ats", help=motion_help)
    engine_help = (
        "what moves the surface: stm; or head, where the weights hold a parametric head: the one that fits the "
        "mesh, or, without --mesh, that of --identity"
    )
    parser.add_argument("--engine", choices=("stm", "head"), default="stm", help=engine_help)
    identity_help = (
        "of a head that no mesh is given for: 'sample:N', another N, another face; or codes that 'freetalk head fit' "
        "wrote; by default sample:0"
    )
    parser.add_argument("--identity", metavar="WHO", help=identity_help)
    parser.add_argument(
        "--precision",
        choices=("float32", "bfloat16"),
        default="float32",
        help="of the networks; bfloat16 is faster where the processor has it",
    )


def add_device(parser: argparse.ArgumentParser) -> None:
    """Adds where the networks run."""
    parser.add_argument(
        "--device", metavar="NAME", help="cpu, cuda or cuda:N; by default a GPU where there is one"
    )
