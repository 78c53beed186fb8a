"""Recorded speech of no face in the training of a speech encoder: phones from forced alignment, no motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freetalk.audio import load_audio
from freetalk.corpus.alignment import aligned_files
from freetalk.data import MotionSequence

#: Source of the recordings in ``task.source_weights``.
RECORDED = "recorded"

FloatArray = npt.NDArray[np.float32]


class Recordings:
    """Sound and phones of the recordings that alignment files name.

    Args:
        files: what ``freetalk speech align`` wrote; recordings are named relative to their file.
        fps: rate at which the lengths are counted.

    Raises:
        OSError: a file or a recording is missing.
        ValueError: a file is no alignment, or two name the same recording.
    """

    def __init__(self, files: Sequence[str], fps: float) -> None:
        self.sequences: list[MotionSequence] = []
        self._phones: dict[str, list[tuple[float, float, str]]] = {}
        self._audio: dict[str, FloatArray] = {}
        for file in files:
            for name, (given, phones) in aligned_files(Path(file)).items():
                path = given.resolve()
                if str(path) in self._phones:
                    raise ValueError(f"{file} names {name}, which is already among the recordings")
                self._phones[str(path)] = [(p.start_s, p.end_s, p.label) for p in phones]
                self.sequences.append(_sequence(path, phones[-1].end_s if phones else 0.0, fps))

    def audio(self, sequence: MotionSequence) -> FloatArray:
        """(S,) float32 in [-1, 1] at 16 kHz."""
        if sequence.id not in self._audio:
            self._audio[sequence.id] = np.array(load_audio(sequence.id).samples, np.float32)
        return self._audio[sequence.id]

    def phones(self, sequence: MotionSequence) -> list[tuple[float, float, str]]:
        """(start in s, end in s, ARPABET label)."""
        return self._phones[sequence.id]


def _sequence(path: Path, duration_s: float, fps: float) -> MotionSequence:
    return MotionSequence(
        id=str(path),
        split="train",
        source=RECORDED,
        take=path.stem,
        start_frame=0,
        stored_frames=0,
        num_frames=max(1, int(duration_s * fps)),
        first_sample=0,
        num_samples=round(duration_s * 16000),
        emotion=0,
        intensity=1.0,
        identity=0,
        voice=None,
        text=None,
        fps=fps,
    )
