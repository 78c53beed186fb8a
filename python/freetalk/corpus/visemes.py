"""Phones to expression weights: viseme targets, coarticulation by dominance functions, hard lip constraints.

Coarticulation follows Cohen and Massaro (1993): every phone s has a target T_sp for each articulator p and a dominance
D_sp(t) = a_sp exp(-|t - s| / tau_p), |t - s| the distance from the phone's middle half; F_p(t) = sum_s D_sp T_sp / sum_s D_sp.
On top, what a blend cannot promise: the lips are closed during p b m, and the lower lip meets the upper teeth in f v.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from freetalk.corpus.assets import Array, FaceModel
from freetalk.corpus.lips import Lips
from freetalk.corpus.phones import BILABIALS, LABIODENTALS, VOWELS, Phone

FPS = 30.0

ARTICULATORS: dict[str, tuple[str, ...]] = {
    "jaw": ("jawOpen",),
    "funnel": ("mouthFunnel",),
    "pucker": ("mouthPucker",),
    "stretch": ("mouthStretch_L", "mouthStretch_R"),
    "smile": ("mouthSmile_L", "mouthSmile_R"),
    "lower": ("mouthLowerDown_L", "mouthLowerDown_R"),
    "upper": ("mouthUpperUp_L", "mouthUpperUp_R"),
    "roll_lower": ("mouthRollLower",),
    "roll_upper": ("mouthRollUpper",),
    "press": ("mouthPress_L", "mouthPress_R"),
    "shrug": ("mouthShrugUpper",),
    "forward": ("jawForward",),
}
TAU_S = {
    "jaw": 0.055,
    "funnel": 0.075,
    "pucker": 0.080,
    "stretch": 0.065,
    "smile": 0.070,
    "forward": 0.07,
}
DEFAULT_TAU_S = 0.045

TARGETS: dict[str, dict[str, float]] = {
    "sil": {},
    "P": {"jaw": 0.05, "press": 0.30, "roll_lower": 0.06},
    "F": {"jaw": 0.05, "roll_lower": 0.27, "upper": 0.22},
    "TH": {"jaw": 0.13, "lower": 0.18, "upper": 0.06, "stretch": 0.05},
    "T": {"jaw": 0.09, "lower": 0.14, "upper": 0.05},
    "L": {"jaw": 0.17, "lower": 0.12, "upper": 0.04},
    "K": {"jaw": 0.13, "lower": 0.10},
    "HH": {"jaw": 0.17},
    "S": {"jaw": 0.055, "lower": 0.22, "upper": 0.12, "stretch": 0.22, "forward": 0.10},
    "SH": {"jaw": 0.04, "funnel": 0.30, "pucker": 0.34, "lower": 0.06, "forward": 0.15},
    "R": {"jaw": 0.11, "funnel": 0.20, "pucker": 0.30},
    "W": {"jaw": 0.05, "pucker": 0.80, "funnel": 0.06},
    "Y": {"jaw": 0.08, "lower": 0.14, "smile": 0.18, "stretch": 0.10},
    "IY": {"jaw": 0.10, "lower": 0.20, "upper": 0.10, "smile": 0.26, "stretch": 0.20},
    "IH": {"jaw": 0.17, "lower": 0.14, "upper": 0.08, "smile": 0.12, "stretch": 0.12},
    "EH": {"jaw": 0.27, "lower": 0.12, "upper": 0.10, "smile": 0.08, "stretch": 0.14},
    "AE": {"jaw": 0.37, "lower": 0.14, "upper": 0.12, "smile": 0.06, "stretch": 0.20},
    "AA": {"jaw": 0.44, "lower": 0.06, "upper": 0.03, "funnel": 0.03},
    "AH": {"jaw": 0.31, "lower": 0.07, "upper": 0.04},
    "AX": {"jaw": 0.19, "lower": 0.07},
    "ER": {"jaw": 0.16, "funnel": 0.22, "pucker": 0.26},
    "AO": {"jaw": 0.34, "funnel": 0.30, "pucker": 0.22},
    "OW": {"jaw": 0.20, "funnel": 0.24, "pucker": 0.52},
    "UH": {"jaw": 0.15, "funnel": 0.18, "pucker": 0.36},
    "UW": {"jaw": 0.06, "funnel": 0.10, "pucker": 0.85},
}
SAME_AS = {
    "B": "P", "M": "P", "V": "F", "DH": "TH", "D": "T", "N": "T", "G": "K", "NG": "K", "Z": "S",
    "ZH": "SH", "CH": "SH", "JH": "SH",
}  # fmt: skip
GLIDES = {"AY": ("AA", "IY", 0.60), "AW": ("AA", "UW", 0.55), "OY": ("AO", "IY", 0.55), "EY": ("EH", "IY", 0.50),
          "OW": ("OW", "UW", 0.60)}  # fmt: skip
"""Diphthongs: first target, second target, share of the duration that belongs to the first."""

ROUNDED = frozenset(("W", "UW", "UH", "OW", "AO", "SH", "R", "ER"))
CLOSURE_SHARE = {"P": 0.70, "B": 0.70, "M": 0.85}
RAMP_S = 0.050
TEETH_OPENING_M = 0.0028
"""Opening at f and v: the raised upper lip shows the teeth's edge, on which the lower lip rests."""


@dataclass(frozen=True)
class SpeakingStyle:
    """How a speaker articulates: overall amplitude, rounding and spreading gains, asymmetry (left minus right)."""

    amplitude: float = 1.0
    rounding: float = 1.0
    spreading: float = 1.0
    asymmetry: float = 0.0


@dataclass(frozen=True)
class _Segment:
    start_s: float
    end_s: float
    viseme: str
    label: str


def frame_times(num_frames: int, fps: float = FPS) -> np.ndarray:
    """(T,) centres of the frames in seconds."""
    return (np.arange(num_frames) + 0.5) / fps


def segments(phones: list[Phone]) -> list[_Segment]:
    """Phones as viseme segments, diphthongs in two."""
    result = []
    for phone in phones:
        if phone.label in GLIDES:
            first, second, share = GLIDES[phone.label]
            middle = phone.start_s + share * (phone.end_s - phone.start_s)
            result.append(_Segment(phone.start_s, middle, first, phone.label))
            result.append(_Segment(middle, phone.end_s, second, phone.label))
        else:
            viseme = SAME_AS.get(phone.label, phone.label)
            result.append(_Segment(phone.start_s, phone.end_s, viseme, phone.label))
    return result


def dominance_strength(segment: _Segment, articulator: str) -> float:
    """How much a segment insists on its target of an articulator."""
    viseme = segment.viseme
    if viseme == "sil":
        return 0.25 if segment.end_s - segment.start_s < 0.15 else 1.2
    if articulator in ("funnel", "pucker"):
        return 2.2 if viseme in ROUNDED else (0.7 if viseme in VOWELS else 0.25)
    if articulator == "jaw":
        return {"P": 1.3, "F": 1.4, "S": 2.0, "SH": 2.2, "T": 0.8, "UW": 1.8, "W": 1.8}.get(
            viseme, 1.3 if viseme in VOWELS else 0.7
        )
    if articulator in ("smile", "stretch"):
        return 1.0 if viseme in VOWELS or viseme in ("S", "Y") or viseme in ROUNDED else 0.4
    return 0.9 if viseme not in ("K", "HH") else 0.3


def blend(
    parts: list[_Segment], times: np.ndarray, scale: np.ndarray, style: SpeakingStyle
) -> np.ndarray:
    """Dominance-weighted articulator tracks (T, P); `scale` (S,) is the loudness factor of each segment."""
    start = np.array([p.start_s for p in parts])
    end = np.array([p.end_s for p in parts])
    quarter = 0.25 * (end - start)
    away = np.maximum(start + quarter - times[:, None], times[:, None] - (end - quarter)).clip(0)
    gains = {"funnel": style.rounding, "pucker": style.rounding, "smile": style.spreading,
             "stretch": style.spreading}  # fmt: skip
    tracks = np.zeros((len(times), len(ARTICULATORS)))
    for column, name in enumerate(ARTICULATORS):
        target = np.array([TARGETS[p.viseme].get(name, 0.0) for p in parts]) * gains.get(name, 1.0)
        if name in ("jaw", "lower", "upper"):
            target = target * scale
        strength = np.array([dominance_strength(p, name) for p in parts])
        dominance = strength * np.exp(-away / TAU_S.get(name, DEFAULT_TAU_S)) + 1e-9
        tracks[:, column] = (dominance * target).sum(1) / dominance.sum(1)
    return tracks


def activation(phones: list[Phone], labels: frozenset[str], times: np.ndarray) -> np.ndarray:
    """(T,) one during the labels' closures (at least on their nearest frame), easing to zero around them."""
    result = np.zeros(len(times))
    for phone in phones:
        if phone.label not in labels:
            continue
        length = phone.end_s - phone.start_s
        start, end = phone.start_s, phone.start_s + CLOSURE_SHARE.get(phone.label, 0.85) * length
        nearest = times[np.abs(times - 0.5 * (start + end)).argmin()]
        start, end = min(start, nearest), max(end, nearest)
        away = np.maximum(np.maximum(start - times, times - end), 0) / RAMP_S
        ease = np.where(away < 1, 0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1)), 0)
        result = np.maximum(result, ease)
    return result


def speech_weights(
    model: FaceModel,
    lips: Lips,
    phones: list[Phone],
    num_frames: int,
    loudness: np.ndarray,
    style: SpeakingStyle,
) -> Array:
    """Expression weights (T, E) of a phone sequence.

    Args:
        phones: contiguous intervals; num_frames: T at 30 fps.
        loudness: (T,) factor about 1 that scales the jaw with the energy of the voice.
        style: of the speaker.
    """
    times = frame_times(num_frames)
    parts = segments(phones)
    middle = np.array([0.5 * (p.start_s + p.end_s) for p in parts])
    scale = style.amplitude * np.interp(middle, times, loudness)
    tracks = blend(parts, times, scale, style)
    names = list(ARTICULATORS)
    teeth = activation(phones, LABIODENTALS, times)[:, None]
    closed = activation(phones, BILABIALS, times)[:, None]
    for pose, amount in (("F", teeth * (1 - closed)), ("P", closed)):
        target = np.array([TARGETS[pose].get(name, 0.0) for name in names])
        kept = np.array(
            [0.55 if name in ("pucker", "funnel", "smile", "stretch") else 0.0 for name in names]
        )
        tracks = (1 - amount) * tracks + amount * np.maximum(target, kept * tracks)
    weights = np.zeros((num_frames, len(model.expression_names)), np.float32)
    for column, name in enumerate(names):
        for shape in ARTICULATORS[name]:
            side = {"_L": 1 + style.asymmetry, "_R": 1 - style.asymmetry}.get(shape[-2:], 1.0)
            weights[:, model.index(shape)] = np.clip(tracks[:, column] * side, 0, 1)
    weights = lips.without_interpenetration(lips.limited(weights))
    opening = lips.opening(weights)
    on_teeth = (teeth * (1 - closed))[:, 0]
    opening = (1 - on_teeth) * opening + on_teeth * TEETH_OPENING_M
    weights = lips.set_opening(weights, (1 - closed[:, 0]) * np.maximum(opening, 0))
    return lips.without_interpenetration(weights)
