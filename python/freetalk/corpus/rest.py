"""What a face does while nothing is said: blinks, breathing, small movements of the brows."""

from __future__ import annotations

import numpy as np

from freetalk.corpus.assets import Array, FaceModel
from freetalk.corpus.emotion import smooth_noise
from freetalk.corpus.lips import Lips


def blink_track(rng: np.random.Generator, num_frames: int, fps: float = 30.0) -> np.ndarray:
    """(T,) lid closure in [0, 1]: intervals of 3-5 s on average, 150-250 ms long, closing faster than opening."""
    t = (np.arange(num_frames) + 0.5) / fps
    track = np.zeros(num_frames)
    mean_interval = rng.uniform(3.0, 5.0)
    at = rng.exponential(mean_interval)
    while at < num_frames / fps:
        length = rng.uniform(0.15, 0.25)
        closing = 0.38 * length
        peak = rng.uniform(0.90, 1.0)
        down = np.clip((t - at) / closing, 0, 1)
        up = np.clip((at + length - t) / (length - closing), 0, 1)
        lid = np.sin(0.5 * np.pi * np.minimum(down, up)) ** 1.3
        nearest = np.abs(t - at - closing).argmin()
        lid[nearest] = 1.0
        track = np.maximum(track, peak * lid)
        at += 0.6 + rng.exponential(mean_interval)
    return track


def add_blinks(
    model: FaceModel, weights: Array, rng: np.random.Generator, fps: float = 30.0
) -> Array:
    """Adds blinks to weights (T, E); wide-open or squinting lids give way while the eye is shut."""
    blink = blink_track(rng, len(weights), fps).astype(np.float32)
    result = weights.copy()
    for side in ("_L", "_R"):
        lid = model.index("eyeBlink" + side)
        result[:, lid] += blink * (1 - result[:, lid])
        for other in ("eyeWide", "eyeSquint", "eyeLookDown"):
            result[:, model.index(other + side)] *= 1 - 0.8 * blink
    return result


def add_idle(
    model: FaceModel,
    lips: Lips,
    weights: Array,
    rng: np.random.Generator,
    fps: float = 30.0,
    amount: float = 1.0,
) -> Array:
    """Adds breathing (nostrils, a trace of jaw under closed lips) and slow brow movement."""
    count = len(weights)
    opening = lips.opening(weights)
    t = np.arange(count) / fps
    breath = 0.5 - 0.5 * np.cos(2 * np.pi * t / rng.uniform(3.0, 4.8) + rng.uniform(0, 2 * np.pi))
    result = weights.copy()
    for name, value in (("noseSneer_L", 0.035), ("noseSneer_R", 0.035), ("jawOpen", 0.020)):
        result[:, model.index(name)] += (amount * value * breath).astype(np.float32)
    for names, size, period in (
        (("browInnerUp_L", "browInnerUp_R"), 0.05, 2.4),
        (("browOuterUp_L", "browOuterUp_R"), 0.04, 3.0),
        (("eyeSquint_L", "eyeSquint_R"), 0.05, 2.8),
    ):
        drift = amount * size * np.maximum(0.4 + smooth_noise(rng, count, period, fps), 0)
        for name in names:
            result[:, model.index(name)] += drift.astype(np.float32)
    return lips.set_opening(np.clip(result, 0, 1), opening)


def rest_weights(
    model: FaceModel, lips: Lips, num_frames: int, rng: np.random.Generator, fps: float = 30.0
) -> Array:
    """(T, E) weights of a silent face with closed lips: breathing and small movements (blinks come on top)."""
    weights = np.zeros((num_frames, len(model.expression_names)), np.float32)
    return add_idle(model, lips, weights, rng, fps, amount=rng.uniform(0.7, 1.3))
