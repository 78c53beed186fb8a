"""``freetalk speech``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from freetalk._files import replacing
from freetalk.cli.outputs import check_readable, check_writable
from freetalk.cli.weights import find_weights


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
