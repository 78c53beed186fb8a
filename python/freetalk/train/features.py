"""Speech features of every sequence, computed once and kept on disk as one array."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from freetalk._files import replacing, write_json
from freetalk.data import Dataset, MotionSequence
from freetalk.data.pack import read_rows
from freetalk.speech import EncodeOptions, SpeechEncoder, encode_speech
from freetalk.train.augment import augment_wave, change_speed, change_voice


@dataclass(frozen=True)
class FeatureCopy:
    """One rendering of a sequence's audio: `speed` times as fast, (num_frames, C) from `start`."""

    start: int
    num_frames: int
    speed: float


@dataclass(frozen=True)
class _Copies:
    """What is computed of a training sequence: altered copies, others in other voices by source; how."""

    augmentations: int
    voices: dict[str, int]
    resampling: str

    def of(self, sequence: MotionSequence) -> tuple[int, int]:
        if sequence.split != "train":
            return 0, 0
        return self.augmentations, self.voices.get(sequence.source, 0)

    def __str__(self) -> str:
        named = "".join(f" {k}={v}" for k, v in sorted(self.voices.items()) if v)
        own = "" if self.resampling == "output" else f" {self.resampling}"
        return f"{self.augmentations}{named}{own}"


class FeatureCache:
    """Features per (sequence, copy); copy 0 is the audio as it is, the others are altered.

    Args:
        corpus: where the audio comes from.
        sequences: what to encode.
        encoder_dir: folder of the speech encoder; its weights are part of the key.
        directory: folder of the cache.
        augmentations: altered copies of each training sequence.
        device: where to encode.
        voices: altered copies in other voices of each training sequence of a source, after the others.
        resampling: where features are brought to the motion's rate: ``output`` of the encoder, or of its
            ``conv``olutions.
    """

    def __init__(
        self,
        corpus: Dataset,
        sequences: Sequence[MotionSequence],
        encoder_dir: Path,
        directory: Path,
        augmentations: int,
        device: torch.device,
        voices: Mapping[str, int] | None = None,
        resampling: str = "output",
    ) -> None:
        self.corpus = corpus
        named = {k: int(v) for k, v in (voices or {}).items()}
        copies = _Copies(augmentations, named, resampling)
        key = _key(corpus, sequences, encoder_dir, copies)
        path = directory / f"speech-features-{key}"
        if not (path / "index.json").is_file():
            _compute(corpus, sequences, encoder_dir, path, copies, device)
        index = json.loads((path / "index.json").read_text())
        self._copies = {
            name: [FeatureCopy(*copy) for copy in copies]
            for name, copies in index["copies"].items()
        }
        self._file, self.width = path / "features.f16", int(index["width"])
        self.mean = np.array(index["mean"], dtype=np.float32)  # (C,)
        self.spread = np.array(index["spread"], dtype=np.float32)  # (C,)

    def copies(self, sequence: MotionSequence) -> list[FeatureCopy]:
        """Renderings of a sequence, the unaltered one first."""
        return self._copies[sequence.id]

    def features(self, copy: FeatureCopy, start: int, stop: int) -> npt.NDArray[np.float32]:
        """Features of frames [start, stop) of a rendering, (T, C)."""
        first, end = copy.start + start, copy.start + min(stop, copy.num_frames)
        return read_rows(self._file, first, end, np.float16, (self.width,)).astype(np.float32)

    def altered(
        self,
        features: npt.NDArray[np.float32],
        noise: float,
        shift: float,
        dropout: float,
        rng: np.random.Generator,
    ) -> npt.NDArray[np.float32]:
        """Features (T, C) as other voices and rooms might give them.

        Args:
            features: (T, C) of a window.
            noise: standard deviation of what is added to each value, in units of the channel's.
            shift: the same of what is added to a channel in all frames.
            dropout: share of the values that become the channel's mean; the others' distance to it
                grows by 1 / (1 - dropout), as in a layer of dropout.
            rng: draws.
        """
        for amount, shape in ((noise, features.shape), (shift, features.shape[-1:])):
            if amount > 0:
                drawn = rng.standard_normal(shape, dtype=np.float32)
                features = features + np.float32(amount) * self.spread * drawn
        if dropout > 0:
            kept = rng.random(features.shape, dtype=np.float32) >= dropout
            distance = (features - self.mean) * kept / np.float32(1 - dropout)
            features = self.mean + distance
        return features


def _key(
    corpus: Dataset,
    sequences: Sequence[MotionSequence],
    encoder_dir: Path,
    copies: _Copies,
) -> str:
    digest = hashlib.sha256(f"5 {copies} {corpus.fingerprint}".encode())
    for name in ("config.json", "model.safetensors"):
        file = encoder_dir / name
        if not file.is_file():
            raise FileNotFoundError(
                f"no speech encoder in {encoder_dir}: {name} is missing; train one with "
                "`freetalk train speech`, or name one with task.speech_encoder=DIR"
            )
        if name == "model.safetensors":
            digest.update(file.read_bytes())
    for s in sequences:
        digest.update(f"{s.id} {s.num_frames}".encode())
    return digest.hexdigest()[:16]


def _compute(
    corpus: Dataset,
    sequences: Sequence[MotionSequence],
    encoder_dir: Path,
    path: Path,
    wanted: _Copies,
    device: torch.device,
) -> None:
    encoder = SpeechEncoder.from_pretrained(encoder_dir).to(device).eval()
    copies: dict[str, list[Any]] = {}
    total = width = 0
    sums = np.zeros((2, 1))
    with replacing(path / "features.f16") as temporary, temporary.open("wb") as file:
        # Row by row: a large dataset's features fit no memory.
        for number, sequence in enumerate(tqdm(sequences, desc="speech features", unit="take")):
            for speed, features in _renderings(
                corpus,
                sequence,
                encoder,
                np.random.default_rng([number, 77]),
                wanted,
            ):
                half = features.astype(np.float16)
                half.tofile(file)
                copies.setdefault(sequence.id, []).append([total, len(half), speed])
                total, width = total + len(half), half.shape[1]
                values = half.astype(np.float64)
                sums = sums + np.stack([values.sum(axis=0), np.square(values).sum(axis=0)])
    mean, square = sums / max(total, 1)
    spread = np.sqrt(np.maximum(square - np.square(mean), 0))
    index = {
        "copies": copies,
        "width": width,
        "mean": mean.tolist(),
        "spread": spread.tolist(),
    }
    write_json(path / "index.json", index)


def _renderings(
    corpus: Dataset,
    sequence: MotionSequence,
    encoder: SpeechEncoder,
    rng: np.random.Generator,
    wanted: _Copies,
) -> Iterator[tuple[float, npt.NDArray[np.float32]]]:
    """Speed and features (T, C) of a sequence's sound: as it is, then altered."""
    wave = corpus.audio(sequence)
    augmentations, voices = wanted.of(sequence)
    options = EncodeOptions(resample=wanted.resampling)
    for copy in range(1 + augmentations + voices):
        speed, heard = 1.0, wave
        if copy > augmentations:
            heard, speed = change_voice(wave, rng, corpus.sample_rate_hz)
        elif copy > 1:
            speed = float(rng.uniform(0.9, 1.1))
            heard = change_speed(wave, speed)
        if copy > 0:
            heard = augment_wave(heard, rng, corpus.sample_rate_hz)
        sound = torch.from_numpy(np.array(heard, dtype=np.float32))
        features = encode_speech(encoder, sound, sequence.fps, options=options).cpu().numpy()
        yield speed, features[: round(sequence.num_frames / speed)]
