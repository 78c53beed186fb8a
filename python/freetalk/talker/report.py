"""What was found, guessed and measured on the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from freetalk.geometry import Similarity


@dataclass(frozen=True)
class FoundAlignment:
    """How a mesh lies whose face was looked for, or told: the fields of ``freetalk.geometry.Alignment``.

    Attributes:
        to_canonical: from the mesh's unit and axes to the canonical frame, m.
        unit: "m", "cm", "mm", "in", or "arbitrary" where none makes a human face.
        up: nearest axis of the mesh to the top of the head, "+y".
        forward: nearest axis of the mesh out of the face.
        guessed: whether it was found rather than told.
        residual_m: mean distance of the mean face from the surface.
        normal_degrees: mean angle between their normals.
        face_like: whether the surface is shaped as human faces are.
        summary: one line.
    """

    to_canonical: Similarity
    unit: str
    up: str
    forward: str
    guessed: bool
    residual_m: float
    normal_degrees: float
    face_like: bool
    summary: str


@dataclass(frozen=True)
class Report:
    """What was found, guessed and measured on the way.

    Attributes:
        alignment: how the mesh lies relative to the canonical frame.
        parts: which vertices are skin, follow it, go with the jaw or stay.
        notices: sentences that a user should read.
        timings: seconds by stage.
        num_frames: frames of all performances.
        decoded_frames: those that STM decoded; the others are interpolated.
        decode_error: checked mean error of interpolated frames, as a share of the mean motion.
        decode_error_mm: checked largest error of interpolated frames.
    """

    alignment: Any
    parts: str
    notices: list[str]
    timings: dict[str, float]
    num_frames: int = 0
    decoded_frames: int = 0
    decode_error: float = 0.0
    decode_error_mm: float = 0.0

    @classmethod
    def of(cls, native: Any, **changes: Any) -> Report:
        """What the native pipeline reports, with changes."""
        fields = {name: getattr(native, name) for name in cls.__dataclass_fields__}
        return cls(**{**fields, **changes})
