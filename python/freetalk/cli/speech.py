"""``freetalk speech``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from freetalk._files import replacing, write_text
from freetalk._pretrained import find_weights
from freetalk.cli.outputs import check_readable, check_writable


def encode(arguments: argparse.Namespace) -> None:
    """Writes speech features, one row a motion frame."""
    out = Path(arguments.out)
    if out.suffix.lower() != ".npy":
        raise ValueError(f"'{arguments.out}' does not say what to write: end it in .npy")
    check_writable(out)
    audio_file = check_readable(arguments.audio, "a recording of speech")
    folder = Path(arguments.encoder) if arguments.encoder else None
    if folder is None:
        folder = find_weights(arguments.pretrained) / "speech"
    import torch

    import freetalk
    from freetalk.speech import SpeechEncoder, encode_speech

    audio = freetalk.load_audio(audio_file)
    encoder = SpeechEncoder.from_pretrained(folder)
    samples = torch.from_numpy(np.array(audio.samples, dtype=np.float32))
    features = encode_speech(encoder, samples, arguments.fps).cpu().numpy()
    with replacing(out) as temporary, temporary.open("wb") as file:
        np.save(file, features)
    print(f"{out}: {features.shape[0]} frames of {features.shape[1]} features")


def convert(arguments: argparse.Namespace) -> None:
    """Turns a pytorch_model.bin into safetensors."""
    source = Path(arguments.source)
    if not source.exists():
        raise ValueError(f"{source}: there is no such file or folder")
    out = Path(arguments.out)
    check_writable(out / "config.json")
    from freetalk.speech import convert_checkpoint

    encoder = convert_checkpoint(source, out, half=arguments.half)
    count = sum(parameter.numel() for parameter in encoder.parameters())
    megabytes = (out / "model.safetensors").stat().st_size / 1e6
    kind = encoder.options.model_type
    print(f"{out}: {kind}, {count / 1e6:.1f} M parameters, {megabytes:.0f} MB")


def align(arguments: argparse.Namespace) -> None:
    """Writes the phone timings of recordings with transcripts, or of what is recognised in them."""
    if arguments.transcripts is None and arguments.audio is None:
        raise ValueError("give --transcripts FILE, or --audio DIR to recognise what is said")
    source = Path(arguments.transcripts or arguments.audio)
    if arguments.transcripts is not None:
        check_readable(arguments.transcripts, "lines RECORDING|TEXT")
    out = Path(arguments.out)
    check_writable(out)
    from tqdm import tqdm

    from freetalk._ffmpeg import AUDIO_SUFFIXES
    from freetalk.audio import load_audio
    from freetalk.corpus.alignment import (
        align_speech,
        alignment_json,
        read_transcripts,
        recognised_words,
    )

    texts: dict[Path, str | None]
    if arguments.transcripts is None:
        found = sorted(path for path in source.rglob("*") if path.suffix.lower() in AUDIO_SUFFIXES)
        texts = dict.fromkeys(found)
    else:
        folder = source.parent if arguments.audio is None else Path(arguments.audio)
        texts = {_recording(folder, name): text for name, text in read_transcripts(source).items()}
    alignments = {}
    left_out = []
    for file, given in tqdm(texts.items(), desc="aligning", delay=2.0, leave=False, disable=None):
        try:
            samples = np.array(load_audio(file).samples, np.float32)
            text, sure = (given, 1.0) if given is not None else recognised_words(samples)
            if sure < arguments.least_sure:
                raise ValueError(f"its words are recognised with a posterior of {sure:.2f} alone")
            phones = align_speech(samples, text)
        except (RuntimeError, ValueError) as error:
            left_out.append(f"{file}: {error}")
            continue
        alignments[os.path.relpath(file.resolve(), out.resolve().parent)] = phones
    if not alignments:
        raise ValueError(left_out[0] if left_out else f"{source} holds no recording")
    write_text(out, alignment_json(alignments))
    for reason in left_out:
        print(f"left out: {reason}", file=sys.stderr)
    seconds = sum(phones[-1].end_s for phones in alignments.values())
    more = f", {len(left_out)} left out (above)" if left_out else ""
    print(f"{out}: {len(alignments)} recordings, {seconds:.0f} s{more}")


def probe(arguments: argparse.Namespace) -> None:
    """Scores a linear probe of viseme classes on an encoder's features, and draws its confusions."""
    fit = [check_readable(file, "aligned recordings") for file in arguments.fit]
    held_out = _named(arguments.held_out)
    out = Path(arguments.out)
    check_writable(out / "probe.json")
    folder = Path(arguments.encoder) if arguments.encoder else None
    if folder is None:
        folder = find_weights(arguments.pretrained) / "speech"
    from freetalk.data import open_dataset
    from freetalk.evaluate import viseme_probe
    from freetalk.speech import SpeechEncoder

    encoder = SpeechEncoder.from_pretrained(folder)
    for layer in arguments.layers:
        if not -1 <= layer <= encoder.options.num_hidden_layers:
            last = encoder.options.num_hidden_layers
            raise ValueError(f"--layers {layer}: the encoder's hidden states are -1 to {last}")
    corpus = open_dataset(arguments.data)
    synthetic = viseme_probe.corpus_recordings(corpus, "train", max(0, arguments.sequences))
    recorded = {
        f"{file}:{name}": recording
        for file in fit
        for name, recording in viseme_probe.aligned_recordings(file).items()
    }
    sets = {"synthetic test voices": viseme_probe.corpus_recordings(corpus, "test")}
    sets |= {name: viseme_probe.aligned_recordings(file) for name, file in held_out.items()}
    out.mkdir(parents=True, exist_ok=True)
    results = []
    for layer in arguments.layers:
        result = viseme_probe.probe_layer(encoder, layer, synthetic, recorded, sets)
        results.append(result)
        suffix = f"_{layer}" if len(arguments.layers) > 1 else ""
        viseme_probe.draw_confusions(result, out / f"probe{suffix}.png")
        _print(result)
    report = {
        "encoder": str(folder),
        "classes": {name: list(phones) for name, phones in viseme_probe.VISEMES.items()},
        "fit": [str(file) for file in fit],
        "layers": results,
    }
    write_text(out / "probe.json", json.dumps(report, indent=1) + "\n")


def _print(result: dict[str, Any]) -> None:
    print(f"layer {result['layer']}")
    for name, scores in result["sets"].items():
        print(
            f"  {name:24s} {100 * scores['accuracy']:5.1f} % of {scores['frames']} frames, "
            f"{100 * scores['accuracy_speech']:5.1f} % without silence "
            f"(largest class alone {100 * scores['largest_class']:.1f} %)"
        )


def _recording(folder: Path, name: str) -> Path:
    """A recording by its name, with ``.wav`` where the transcripts leave it out."""
    for path in (folder / name, folder / f"{name}.wav", folder / "wavs" / f"{name}.wav"):
        if path.is_file():
            return path
    raise FileNotFoundError(f"there is no recording {folder / name}")


def _named(given: list[str]) -> dict[str, Path]:
    """``NAME=JSON``, or ``JSON``, which is called as its folder."""
    from freetalk.data import parse_spec

    named: dict[str, Path] = {}
    for text in given:
        name, _, file = parse_spec(text)
        name = name or Path(text).resolve().parent.name
        if name in named:
            raise ValueError(f"two sets are called {name}: give them names, NAME=JSON")
        named[name] = check_readable(file, "aligned recordings")
    return named
