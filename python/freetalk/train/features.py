"""Speech features of every sequence, computed once and kept on disk as one memory-mapped array."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from freetalk.data import MotionSequence, OpenCorpus
from freetalk.speech import SpeechEncoder, encode_speech
from freetalk.train.augment import augment_wave, change_speed
from freetalk.train.checkpoint import write_json


@dataclass(frozen=True)
class FeatureCopy:
    """One rendering of a sequence's audio: `speed` times as fast, (num_frames, C) from `start`."""

    start: int
    num_frames: int
    speed: float


class FeatureCache:
    """Features per (sequence, copy); copy 0 is the audio as it is, the others are altered.

    Args:
        corpus: where the audio comes from.
        sequences: what to encode.
        encoder_dir: folder of the speech encoder; its weights are part of the key.
        directory: folder of the cache.
        augmentations: altered copies of each training sequence.
        device: where to encode.
    """

    def __init__(
        self,
        corpus: OpenCorpus,
        sequences: Sequence[MotionSequence],
        encoder_dir: Path,
        directory: Path,
        augmentations: int,
        device: torch.device,
    ) -> None:
        self.corpus = corpus
        key = _key(corpus, sequences, encoder_dir, augmentations)
        path = directory / f"speech-features-{key}"
        if not (path / "index.json").is_file():
            _compute(corpus, sequences, encoder_dir, path, augmentations, device)
        index = json.loads((path / "index.json").read_text())
        self._copies = {
            name: [FeatureCopy(*copy) for copy in copies]
            for name, copies in index["copies"].items()
        }
        self._array = np.load(path / "features.npy", mmap_mode="r", allow_pickle=False)
        self.width = int(self._array.shape[1])
        self.spread = np.array(index["spread"], dtype=np.float32)  # (C,)

    def copies(self, sequence: MotionSequence) -> list[FeatureCopy]:
        """Renderings of a sequence, the unaltered one first."""
        return self._copies[sequence.id]

    def features(self, copy: FeatureCopy, start: int, stop: int) -> npt.NDArray[np.float32]:
        """Features of frames [start, stop) of a rendering, (T, C)."""
        stop = min(stop, copy.num_frames)
        return np.array(self._array[copy.start + start : copy.start + stop], dtype=np.float32)


def _key(
    corpus: OpenCorpus, sequences: Sequence[MotionSequence], encoder_dir: Path, augmentations: int
) -> str:
    digest = hashlib.sha256(f"2 {augmentations} {corpus.directory}".encode())
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
        size = s.audio.stat().st_size if s.audio is not None else 0
        digest.update(f"{s.id} {s.num_frames} {size}".encode())
    return digest.hexdigest()[:16]


def _compute(
    corpus: OpenCorpus,
    sequences: Sequence[MotionSequence],
    encoder_dir: Path,
    path: Path,
    augmentations: int,
    device: torch.device,
) -> None:
    encoder = SpeechEncoder.from_pretrained(encoder_dir).to(device).eval()
    parts: list[npt.NDArray[np.float16]] = []
    copies: dict[str, list[Any]] = {}
    total = 0
    for number, sequence in enumerate(tqdm(sequences, desc="speech features", unit="take")):
        rng = np.random.default_rng([number, 77])
        wave = corpus.audio(sequence)
        renderings = augmentations if sequence.split == "train" else 0
        for copy in range(1 + renderings):
            speed, heard = 1.0, wave
            if copy > 0:
                speed = float(rng.uniform(0.9, 1.1)) if copy > 1 else 1.0
                heard = augment_wave(change_speed(wave, speed), rng, corpus.sample_rate_hz)
            features = encode_speech(encoder, torch.from_numpy(heard), corpus.fps).cpu().numpy()
            frames = min(len(features), round(sequence.num_frames / speed))
            parts.append(features[:frames].astype(np.float16))
            copies.setdefault(sequence.id, []).append([total, frames, speed])
            total += frames
    array = np.concatenate(parts)
    spread = array.astype(np.float32).std(axis=0)
    path.mkdir(parents=True, exist_ok=True)
    temporary = path / f".features.{os.getpid()}.npy"
    np.save(temporary, array)
    temporary.replace(path / "features.npy")
    write_json(path / "index.json", {"copies": copies, "spread": spread.tolist()})
