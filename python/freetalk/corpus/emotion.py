"""Emotion overlays: a pose per label on upper face and mouth corners, varying in time, at intensities 1 to 3.

Poses follow the usual action-unit descriptions of each emotion; those that share units (afraid and surprise, angry and
disgust, ill and drunk and ashamed) were set apart in brows and lids, since landmarks are all that a model sees. The lips'
opening of the speech beneath is restored after the overlay, so an emotion never stops the lips from closing.
"""

from __future__ import annotations

import numpy as np

from freetalk._native import ats as _native
from freetalk.corpus.assets import Array, FaceModel
from freetalk.corpus.lips import Lips

EMOTIONS: tuple[str, ...] = tuple(_native.AtsOptions().emotions)
"""The model's vocabulary; every name has a pose below."""
LEVELS = {1: 0.42, 2: 0.70, 3: 1.0}
"""Share of the full pose at each intensity."""

POSES: dict[str, dict[str, float]] = {
    "neutral": {},
    "afraid": {"browInnerUp": 0.95, "browDown": 0.25, "eyeWide": 1.0, "mouthStretch": 0.40, "mouthFrown": 0.10},
    "ashamed": {"eyeLookDown": 0.9, "eyeBlink": 0.05, "browInnerUp": 0.55, "mouthFrown": 0.25, "mouthPress": 0.25,
                "mouthRollLower": 0.12},
    "angry": {"browDown": 1.0, "eyeWide": 0.40, "noseSneer": 0.25, "mouthPress": 0.30, "mouthFrown": 0.25},
    "disgust": {"noseSneer": 0.60, "browDown": 0.45, "eyeSquint": 0.80, "cheekRaiser": 0.60, "mouthFrown": 0.25},
    "happy": {"cheekRaiser": 0.75, "cheekSquint": 0.70, "eyeSquint": 0.80, "browOuterUp": 0.20, "browInnerUp": 0.15,
              "mouthSmile": 0.60, "mouthDimple": 0.10},
    "sad": {"browInnerUp": 1.0, "eyeBlink": 0.20, "mouthFrown": 0.55, "mouthShrugLower": 0.08},
    "drunk": {"eyeBlink": 0.42, "browOuterUp": 0.70, "browInnerUp": 0.35, "mouthSmile_L": 0.22, "cheekPuff": 0.06},
    "ill": {"eyeBlink": 0.50, "browDown": 0.70, "browInnerUp": 0.45, "cheekSquint": 0.30, "noseSneer": 0.12,
            "mouthFrown": 0.30},
    "suspicious": {"eyeSquint": 1.0, "eyeBlink": 0.22, "browDown_L": 0.95, "browDown_R": 0.30, "browOuterUp_R": 0.80,
                   "mouthPress": 0.20, "mouthLeft": 0.10},
    "pleased": {"browOuterUp": 0.15, "cheekSquint": 0.60, "eyeBlink": 0.50, "mouthSmile": 0.40},
    "upset": {"browInnerUp": 0.75, "browDown": 0.85, "eyeSquint": 0.25, "cheekRaiser": 0.20, "mouthFrown": 0.50,
              "mouthShrugLower": 0.08},
    "surprise": {"browInnerUp": 1.0, "browOuterUp": 1.0, "eyeWide": 0.65},
    "contempt": {"browOuterUp_L": 0.80, "browInnerUp_L": 0.35, "browDown_R": 0.20, "eyeBlink": 0.24, "mouthSmile_L": 0.40,
                 "mouthDimple_L": 0.50, "cheekSquint_L": 0.35},
}  # fmt: skip

PROSODY: dict[str, tuple[float, float]] = {
    "afraid": (1.10, 1.15), "ashamed": (0.88, 0.92), "angry": (1.10, 1.08), "disgust": (0.94, 0.95), "happy": (1.06, 1.14),
    "sad": (0.84, 0.90), "drunk": (0.80, 0.95), "ill": (0.86, 0.92), "suspicious": (0.94, 0.94), "pleased": (0.98, 1.06),
    "upset": (1.04, 1.04), "surprise": (1.06, 1.18), "contempt": (0.92, 0.95),
}  # fmt: skip
"""Speaking rate and pitch factors of each label for synthetic voices, at intensity 3."""


def level(intensity: float) -> float:
    """Share of the full pose at a real intensity in [1, 3]."""
    return float(np.interp(intensity, list(LEVELS), list(LEVELS.values())))


def pose(model: FaceModel, emotion: str) -> Array:
    """(E,) weights of the full pose; a name without side stands for both sides."""
    if emotion not in POSES:
        raise ValueError(f"emotion is {emotion!r}: use one of {', '.join(EMOTIONS)}")
    weights = np.zeros(len(model.expression_names), np.float32)
    for name, value in POSES[emotion].items():
        shapes = [name] if name in model.expression_names else [f"{name}_L", f"{name}_R"]
        for shape in shapes:
            weights[model.index(shape)] = max(weights[model.index(shape)], value)
    return weights


def smooth_noise(
    rng: np.random.Generator, num_frames: int, period_s: float, fps: float
) -> np.ndarray:
    """(T,) slow noise in about [-1, 1]: four sinusoids around a period with random phases."""
    t = np.arange(num_frames) / fps
    periods = period_s * rng.uniform(0.6, 1.8, 4)
    phases = rng.uniform(0, 2 * np.pi, 4)
    return np.sin(2 * np.pi * t[:, None] / periods + phases).sum(1) / 2.5


def envelope(rng: np.random.Generator, num_frames: int, fps: float) -> np.ndarray:
    """(T,) course of an emotion over a sequence: onset, slow variation about one, offset."""
    t = np.arange(num_frames) / fps
    duration = num_frames / fps
    floor_in, floor_out = rng.uniform(0.55, 1.0, 2)
    onset, offset = rng.uniform(0.2, 0.8, 2)
    rise = floor_in + (1 - floor_in) * np.clip(t / onset, 0, 1)
    fall = floor_out + (1 - floor_out) * np.clip((duration - t) / offset, 0, 1)
    return rise * fall * (0.92 + 0.10 * smooth_noise(rng, num_frames, 2.5, fps))


def add_emotion(
    model: FaceModel,
    lips: Lips,
    weights: Array,
    emotion: str,
    intensity: float,
    rng: np.random.Generator,
    fps: float = 30.0,
) -> Array:
    """Adds an emotion to weights (T, E) and restores the lips' opening."""
    opening = lips.opening(weights)
    full = pose(model, emotion)
    count = len(weights)
    course = level(intensity) * envelope(rng, count, fps)
    overlay = np.zeros_like(weights)
    for column in np.flatnonzero(full):
        wobble = 1 + 0.10 * smooth_noise(rng, count, 1.8, fps)
        overlay[:, column] = full[column] * course * wobble
    combined = np.clip(weights + overlay, 0, 1)
    if emotion in ("happy", "pleased", "contempt"):
        _yield_rounding(model, weights, overlay, combined)
    return lips.without_interpenetration(lips.set_opening(combined, opening))


def _yield_rounding(model: FaceModel, weights: Array, overlay: Array, combined: Array) -> None:
    """A smile gives way while the lips are rounded, as both pull the corners in opposite directions."""
    rounding = weights[:, model.index("mouthPucker")] + weights[:, model.index("mouthFunnel")]
    keep = 1 - 0.5 * np.clip(rounding, 0, 1)
    for shape in ("mouthSmile_L", "mouthSmile_R", "mouthDimple_L", "mouthDimple_R"):
        column = model.index(shape)
        combined[:, column] = np.clip(weights[:, column] + overlay[:, column] * keep, 0, 1)
