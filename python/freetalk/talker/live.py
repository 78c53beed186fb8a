"""A live stream: speech in as it is spoken, frames out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from freetalk import _native
from freetalk.ats import Emotion, emotion_text
from freetalk.talker.placement import Placement

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

LiveFrame = _native.talker.LiveFrame


class Live:
    """One stream on one face, made by :meth:`Face.live`. Not to be shared between threads; the face may be.

    Frames are the same however the samples are divided over the calls: to the bit on the CPU, up to rounding on a GPU.
    """

    def __init__(self, native: Any, placement: Placement | None = None) -> None:
        self._native = native
        self._placement = placement

    def push(self, samples: ArrayLike) -> list[LiveFrame]:
        """Frames that are final with further samples.

        Args:
            samples: (n,) mono speech in [-1, 1] at 16 kHz, n may be 0.

        Returns:
            Frames in order, each with ``index``, ``time_s`` of the speech it belongs to, ``landmarks`` (68, 3),
            ``weights`` (W,) in [0, 1] of the face's rig (None where the stream has none), and ``head`` (4, 4), its rigid
            motion in the canonical frame (None without ``head_motion``).
        """
        return self._native.push(np.asarray(samples, dtype=np.float32))

    def finish(self) -> list[LiveFrame]:
        """The rest, as if the speech ended here: round(duration * fps) frames in all. Then it starts afresh."""
        return self._native.finish()

    def reset(self) -> None:
        """Forgets everything, as if nothing had been pushed."""
        self._native.reset()

    def set_emotion(self, emotion: Emotion, intensity: float | None = None) -> None:
        """Another emotion from the last pushed sample on; keyframes count from there.

        Raises:
            ValueError: an unknown emotion (the message lists the known), or an intensity out of range.
        """
        self._native.set_emotion(emotion_text(emotion), intensity)

    def decode(self, frame: LiveFrame) -> torch.Tensor:
        """(V, 3) float32 vertices of a frame, in the mesh's own unit and axes."""
        vertices: torch.Tensor = self._native.decode(frame)
        if self._placement is None:
            return vertices
        return self._placement.move(vertices)

    def head(self, frame: LiveFrame) -> torch.Tensor | None:
        """(4, 4) float64 rigid motion of the head in a frame, in the mesh's own unit and axes; None without ``head_motion``.

        The vertices of :meth:`decode` are without it.
        """
        moved: torch.Tensor | None = self._native.head(frame)
        return moved if self._placement is None else self._placement.head_motion(moved)

    @property
    def latency_s(self) -> float:
        """The longest time from a frame's moment to the sample that makes it final."""
        return self._native.latency_s

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._native.fps
