"""A corpus of seconds in the packed layout, made of bumps and noise, for tests of its readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freetalk.data import EMOTIONS, PackWriter
from freetalk.data.pose import METRES

EXPRESSIONS = ["jawOpen", "mouthFunnel", "mouthSmile_L", "browInnerUp", "eyeBlink_L", "cheekPuff"]
FPS, RATE = 30, 16000


def write_mini_corpus(directory: Path, seed: int = 0) -> Path:
    """Writes the corpus and returns its folder."""
    rng = np.random.default_rng(seed)
    basis = rng.normal(0, 0.003, (len(EXPRESSIONS), 68, 3))
    with PackWriter(directory, {"mini": seed}) as writer:
        for number, (split, source) in enumerate(
            (s, o)
            for s in ("train", "val", "test")
            for o in ("facegood", "synthetic", "rom", "rest")
        ):
            frames = 75 + 5 * number
            motion = _weights(rng, frames) * (0.02 if source == "rest" else 1.0)
            wave = np.zeros(0)
            if source != "rom":
                loudness = np.interp(
                    np.arange(frames * RATE // FPS) * FPS / RATE, range(frames), motion[:, 0]
                )
                wave = (0.3 * loudness * rng.standard_normal(len(loudness))).clip(-1, 1)
            phones = [[0.0, 0.5, "sil"], [0.5, 1.0, "P"], [1.0, 1.8, "AA"]]
            writer.add(
                {
                    "id": f"{source}_{split}",
                    "split": [split],
                    "source": source,
                    "take": None,
                    "emotion": EMOTIONS[number % 14 if source == "synthetic" else 0],
                    "intensity": 2.0 if source == "synthetic" else 1.0,
                    "identity": 0,
                    "voice": None,
                    "text": None,
                },
                np.tensordot(motion, basis, axes=1),
                motion,
                np.rint(32767 * wave).astype(np.int16),
                phones=phones if source == "synthetic" else None,
            )
        meshings = [
            _topology(rng, name, split, side)
            for name, split, side in (
                ("coarse", "train", 9),
                ("fine", "train", 12),
                ("middle", "val", 10),
                ("finest", "test", 14),
            )
        ]
        manifest = {
            "name": "open",
            "fps": FPS,
            "expressions": EXPRESSIONS,
            "moves": "all",
            "splits": {"corpus": "made so"},
            "facts": {"kind": "open", "size": "mini", "seed": seed, **METRES.describe()},
            "identities": [
                {"name": str(i), "split": s, "origin": [0.0, 0.0, 0.0]}
                for i, s in enumerate(("train", "train", "val", "test"))
            ],
            "topologies": [entry for entry, _ in meshings],
        }
        identities = rng.normal(0, 1, (4, 100))
        arrays = {str(entry["name"]): own for entry, own in meshings}
        return writer.finish(manifest, identities, arrays, landmark_basis=basis.astype(np.float32))


def _weights(rng: np.random.Generator, frames: int) -> np.ndarray:
    times = np.arange(frames)[:, None] / FPS
    hertz = rng.uniform(0.5, 3, len(EXPRESSIONS))
    return 0.5 + 0.5 * np.sin(2 * np.pi * (hertz * times + rng.random(len(EXPRESSIONS))))


def _topology(
    rng: np.random.Generator, name: str, split: str, side: int
) -> tuple[dict[str, object], dict[str, np.ndarray]]:
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
    arrays = {
        "neutral": neutral.astype(np.float32),
        "faces": faces.astype(np.int32),
        "expression_basis": expression.astype(np.float16),
        "identity_basis": rng.normal(0, 1e-5, (100, len(neutral), 3)).astype(np.float16),
        "lip_mask": np.abs(neutral[:, 1] + 0.03) < 0.02,
        "upper_face_mask": neutral[:, 1] > 0.02,
    }
    entry = {
        "name": name,
        "split": split,
        "file": f"topologies/{name}.npz",
        "num_vertices": len(neutral),
        "num_faces": len(faces),
        "description": f"grid of {side} x {side}",
    }
    return entry, arrays
