"""A corpus of seconds in the open corpus's layout, made of bumps and noise, for tests of its readers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import soundfile

from freetalk.data.dataset import EMOTIONS

EXPRESSIONS = ["jawOpen", "mouthFunnel", "mouthSmile_L", "browInnerUp", "eyeBlink_L", "cheekPuff"]
FPS, RATE = 30, 16000


def write_mini_corpus(directory: Path, seed: int = 0) -> Path:
    """Writes the corpus and returns its folder."""
    rng = np.random.default_rng(seed)
    (directory / "audio").mkdir(parents=True)
    (directory / "topologies").mkdir()
    basis = rng.normal(0, 0.003, (len(EXPRESSIONS), 68, 3))
    sequences, weights, phones, start = [], [], {}, 0
    for number, (split, source) in enumerate(
        [(s, o) for s in ("train", "val", "test") for o in ("facegood", "synthetic", "rom", "rest")]
    ):
        frames = 75 + 5 * number
        motion = _weights(rng, frames) * (0.02 if source == "rest" else 1.0)
        audio = None
        if source != "rom":
            audio = f"audio/{number}.flac"
            loudness = np.interp(
                np.arange(frames * RATE // FPS) * FPS / RATE, range(frames), motion[:, 0]
            )
            wave = 0.3 * loudness * rng.standard_normal(len(loudness))
            soundfile.write(directory / audio, np.clip(wave, -1, 1), RATE)
            if source == "synthetic":
                phones[audio] = [[0.0, 0.5, "sil"], [0.5, 1.0, "P"], [1.0, 1.8, "AA"]]
        sequences.append(
            {
                "id": f"{source}_{split}",
                "split": split,
                "source": source,
                "take": None,
                "audio": audio,
                "start_frame": start,
                "num_frames": frames,
                "emotion": EMOTIONS[number % 14 if source == "synthetic" else 0],
                "intensity": 2.0 if source == "synthetic" else 1.0,
                "identity": 0,
                "voice": None,
                "text": None,
            }
        )
        weights.append(motion)
        start += frames
    packed = np.concatenate(weights).astype(np.float32)
    np.save(directory / "weights.npy", packed)
    np.save(directory / "landmarks.npy", np.tensordot(packed, basis, axes=1).astype(np.float32))
    np.save(directory / "identities.npy", rng.normal(0, 1, (4, 100)).astype(np.float32))
    (directory / "phones.json").write_text(json.dumps(phones))
    topologies = [
        _write_topology(directory, rng, name, split, side)
        for name, split, side in (
            ("coarse", "train", 9),
            ("fine", "train", 12),
            ("middle", "val", 10),
            ("finest", "test", 14),
        )
    ]
    manifest = {
        "format": "freetalk-open-corpus",
        "version": 1,
        "size": "mini",
        "seed": seed,
        "fps": FPS,
        "sample_rate_hz": RATE,
        "emotions": EMOTIONS,
        "expressions": EXPRESSIONS,
        "sequences": sequences,
        "identities": [
            {"index": i, "split": s} for i, s in enumerate(("train", "train", "val", "test"))
        ],
        "topologies": topologies,
    }
    (directory / "manifest.json").write_text(json.dumps(manifest))
    return directory


def _weights(rng: np.random.Generator, frames: int) -> np.ndarray:
    times = np.arange(frames)[:, None] / FPS
    hertz = rng.uniform(0.5, 3, len(EXPRESSIONS))
    return 0.5 + 0.5 * np.sin(2 * np.pi * (hertz * times + rng.random(len(EXPRESSIONS))))


def _write_topology(
    directory: Path, rng: np.random.Generator, name: str, split: str, side: int
) -> dict[str, object]:
    x, y = np.meshgrid(np.linspace(-0.07, 0.07, side), np.linspace(-0.09, 0.09, side))
    neutral = np.stack([x, y, 0.04 - 4 * x**2 - 2 * y**2], axis=-1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + side], axis=1),
            np.stack([corner + 1, corner + side + 1, corner + side], axis=1),
        ]
    )
    shared = np.random.default_rng(1)  # expressions are those of the face, not of its meshing
    centres = shared.uniform(-0.05, 0.05, (len(EXPRESSIONS), 1, 3))
    bumps = np.exp(-np.square(neutral - centres).sum(axis=-1) / 0.06**2)
    expression = bumps[..., None] * shared.normal(0, 0.005, (len(EXPRESSIONS), 1, 3))
    np.savez(
        directory / "topologies" / f"{name}.npz",
        neutral=neutral.astype(np.float32),
        faces=faces.astype(np.int32),
        expression_basis=expression.astype(np.float16),
        identity_basis=rng.normal(0, 1e-5, (100, len(neutral), 3)).astype(np.float16),
        lip_mask=np.abs(neutral[:, 1] + 0.03) < 0.02,
        upper_face_mask=neutral[:, 1] > 0.02,
    )
    return {
        "name": name,
        "split": split,
        "file": f"topologies/{name}.npz",
        "num_vertices": len(neutral),
        "num_faces": len(faces),
        "description": f"grid of {side} x {side}",
    }
