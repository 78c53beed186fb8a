"""Time of the speech encoder against ``transformers`` (scaled dot product attention), interleaved in one run.

    .venv/bin/python scripts/bench/speech.py [--seconds 10 30] [--rounds 5] [--threads 2]
    .venv/bin/python scripts/bench/speech.py --memory MINUTES [--encoder DIR] [--audio FILE] [--whole] [--stream]

Base size, random weights, one clip, no gradients. Prints the median of each and the ratio to ``transformers`` in the
same precision, and how far the output is from that of ``transformers`` in float32, relative to its largest value and
in the mean. ``--memory`` encodes a long clip instead, with any encoder and any sound (repeated to the length), and
prints the peak memory of the process, how far the features are from one pass over the whole clip for several windows
(``--whole``), and how far a stream's are from those of the same pieces offline (``--stream``).
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from freetalk.audio import load_audio
from freetalk.speech import (
    EncodeOptions,
    SpeechEncoder,
    SpeechStream,
    encode_speech,
    hubert_base,
    normalize_wave,
    stream_options,
)


def speech_like(seconds: float) -> torch.Tensor:
    """Noise with the slow loudness of speech, (S,)."""
    count = int(seconds * 16000)
    loudness = torch.nn.functional.interpolate(
        torch.rand(1, 1, max(2, int(seconds * 4))), count, mode="linear"
    ).view(-1)
    return 0.1 * torch.randn(count) * loudness


def reference(encoder: SpeechEncoder) -> torch.nn.Module:
    """The same weights in ``transformers``."""
    import transformers

    config = transformers.HubertConfig(mask_time_prob=0.0, attn_implementation="sdpa")
    model = transformers.HubertModel(config).eval()
    missing, unexpected = model.load_state_dict(encoder.state_dict(), strict=False)
    assert not unexpected and set(missing) <= {"masked_spec_embed"}
    return model


def compare(seconds: float, rounds: int) -> None:
    torch.manual_seed(0)
    encoder = SpeechEncoder(hubert_base()).eval()
    model = reference(encoder)
    wave = normalize_wave(speech_like(seconds))[None]

    def in_bf16(module: Callable[[torch.Tensor], object]) -> object:
        with torch.autocast("cpu", torch.bfloat16):
            return module(wave)

    ways: dict[str, Callable[[], object]] = {
        "transformers float32": lambda: model(wave).last_hidden_state,
        "freetalk float32": lambda: encoder(wave),
        "transformers bf16": lambda: in_bf16(lambda x: model(x).last_hidden_state),
        "freetalk bf16": lambda: in_bf16(encoder),
    }
    times: dict[str, list[float]] = {name: [] for name in ways}
    outputs = {name: way() for name, way in ways.items()}
    for _ in range(rounds):
        for name, way in ways.items():
            start = time.perf_counter()
            way()
            times[name].append(time.perf_counter() - start)
    expected = outputs["transformers float32"].float()
    print(f"{seconds:g} s of speech, {torch.get_num_threads()} threads, median of {rounds}:")
    for name in ways:
        found = outputs[name].float()
        worst = ((found - expected).abs().max() / expected.abs().max()).item()
        mean = ((found - expected).norm() / expected.norm()).item()
        median = statistics.median(times[name])
        public = statistics.median(times[name.replace("freetalk", "transformers")])
        print(
            f"  {name:22s} {1e3 * median:7.0f} ms  {public / median:5.2f} x  "
            f"difference max {worst:.1e}, mean {mean:.1e}"
        )


def long_sound(minutes: float, audio: str | None) -> torch.Tensor:
    """A recording repeated to the length, or noise."""
    if audio is None:
        return speech_like(60 * minutes)
    samples = torch.from_numpy(np.array(load_audio(audio).samples, np.float32))
    count = int(60 * minutes * 16000)
    return samples.repeat(-(-count // len(samples)))[:count]


def long_clip(encoder: SpeechEncoder, samples: torch.Tensor, whole: bool, stream: bool) -> None:
    minutes = len(samples) / 960000
    start = time.perf_counter()
    features = encode_speech(encoder, samples, 30.0)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{minutes:g} min in {seconds:.0f} s, peak memory of the process {peak:.2f} GiB")
    if stream:
        listener = SpeechStream(encoder, 30.0)
        parts = [listener.push(piece) for piece in samples.split(1600)]
        heard = torch.cat([*parts, listener.finish()])
        options = stream_options()
        print(
            f"  streamed, latency {listener.latency_s:.2f} s, against the same pieces offline: ",
            end="",
        )
        print(difference(heard, encode_speech(encoder, samples, 30.0, options=options)))
    if whole:
        options = EncodeOptions(window_s=60 * minutes + 1)
        expected = encode_speech(encoder, samples, 30.0, options=options)
        print(
            f"  against one pass over the clip, the default window: {difference(features, expected)}"
        )
        for window_s, context_s in ((6, 2), (12, 2), (20, 2), (20, 4), (40, 2), (40, 4), (60, 2)):
            options = EncodeOptions(window_s=window_s, context_s=context_s)
            found = encode_speech(encoder, samples, 30.0, options=options)
            print(f"  window {window_s} s, context {context_s} s: {difference(found, expected)}")


def difference(found: torch.Tensor, expected: torch.Tensor) -> str:
    relative = ((found - expected).norm() / expected.norm()).item()
    worst = ((found - expected).abs().max() / expected.abs().max()).item()
    return f"mean {relative:.1e}, max {worst:.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, nargs="+", default=[10.0, 30.0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--memory", type=float, metavar="MINUTES")
    parser.add_argument("--encoder", metavar="DIR")
    parser.add_argument("--audio", metavar="FILE")
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--stream", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    with torch.no_grad():
        if arguments.memory is not None:
            torch.manual_seed(0)
            encoder = (
                SpeechEncoder.from_pretrained(arguments.encoder)
                if arguments.encoder
                else SpeechEncoder(hubert_base()).eval()
            )
            samples = long_sound(arguments.memory, arguments.audio)
            long_clip(encoder, samples, arguments.whole, arguments.stream)
            return
        for seconds in arguments.seconds:
            compare(seconds, arguments.rounds)


if __name__ == "__main__":
    main()
