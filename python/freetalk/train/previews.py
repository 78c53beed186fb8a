"""Samples of a training to look at: predicted beside true motion, as a video with its sound."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk._pretrained import PRETRAINED
from freetalk.data import Dataset, MotionSequence
from freetalk.geometry import surface_operators
from freetalk.stm import Stm

FloatArray = npt.NDArray[np.float32]
Picture = npt.NDArray[np.uint8]

#: Pixels of a side of each face, and moments in the picture.
_SIDE = 360
_MOMENTS = 6


@dataclass
class Sample:
    """Motion that a model predicts and the true one, on one face.

    Attributes:
        vertices: (V, 3) neutral face in the canonical frame, m.
        faces: (F, 3) triangles.
        predicted: (T, V, 3) displacements, m.
        true: (T, V, 3) displacements, m; ``None`` where no vertex's motion is known.
        fps: frames per second.
        audio: (S,) sound in [-1, 1]; empty where there is none.
        sample_rate_hz: of the sound.
    """

    vertices: FloatArray
    faces: npt.NDArray[np.int64]
    predicted: FloatArray
    true: FloatArray | None
    fps: float
    audio: FloatArray = field(default_factory=lambda: np.zeros(0, np.float32))
    sample_rate_hz: int = 16000


class MeanFace:
    """The mean face, moved by landmarks through a landmarks-to-mesh network.

    Args:
        weights: folder of the network; where it has none, the shipped one.
        device: where to compute.
    """

    def __init__(self, weights: Path, device: torch.device) -> None:
        from freetalk.corpus.assets import mean_face  # which needs seconds to import

        trained = (weights / "config.json").is_file()
        self._stm = Stm.from_pretrained(weights if trained else PRETRAINED / "open-small" / "stm")
        self._stm = self._stm.to(device)
        self.vertices, faces = mean_face("face")
        self.faces = faces.astype(np.int64)
        scale = self._stm.options.length_scale
        operators = surface_operators(
            self.vertices.astype(np.float64) / scale, self.faces, k=self._stm.options.k_eig
        )
        self._operators = operators.to(dtype=torch.float32, device=str(device))
        self._positions = torch.from_numpy(self.vertices).to(device)

    @torch.no_grad()
    def moved(self, landmarks: Tensor) -> FloatArray:
        """Vertex displacements (T, V, 3), m, of landmark displacements (T, 68, 3), m."""
        landmarks = landmarks.to(self._positions)
        features = self._stm.encode(self._positions, self._operators)
        parts = [self._stm.decode(features, self._operators, part) for part in landmarks.split(16)]
        return torch.cat(parts).float().cpu().numpy()


def sample_of(
    face: MeanFace, corpus: Dataset, sequence: MotionSequence, predicted: Tensor
) -> Sample:
    """The mean face moved by predicted landmarks and by those of a sequence, with its sound.

    Args:
        face: who speaks.
        corpus: whose sequence it is.
        sequence: what is spoken, from its first frame on.
        predicted: (T, 68, 3) displacements, m.
    """
    true = torch.from_numpy(corpus.landmarks(sequence, 0, len(predicted)))
    rate = corpus.sample_rate_hz
    return Sample(
        vertices=face.vertices,
        faces=face.faces,
        predicted=face.moved(predicted),
        true=face.moved(true),
        fps=sequence.fps,
        audio=corpus.audio(sequence)[: round(len(predicted) / sequence.fps * rate)],
        sample_rate_hz=rate,
    )


def save_sample(sample: Sample, path: Path) -> Picture:
    """Writes ``path.mp4``, predicted motion on the left and true, where it is known, on the right.

    Args:
        sample: what to show.
        path: where, without the suffix.

    Returns:
        (H, W, 3) moments side by side, the predicted ones above the true ones.

    Raises:
        RuntimeError: no OpenGL or no ffmpeg.
    """
    from freetalk.viz import FaceRenderer, Sequence, View, write_video

    path.parent.mkdir(parents=True, exist_ok=True)
    view = View(occlusion=False)
    sides: list[list[Picture]] = []
    for motion in (sample.predicted, sample.true):
        if motion is None:
            continue
        sequence = Sequence(sample.vertices, sample.faces, motion, sample.fps, located=True)
        with FaceRenderer(sequence, (_SIDE, _SIDE), view) as renderer:
            sides.append([renderer.image(sequence.frame(k)) for k in range(len(motion))])
    frames = [np.concatenate(pair, axis=1) for pair in zip(*sides)]
    write_video(
        path.with_suffix(".mp4"),
        frames,
        (len(sides) * _SIDE, _SIDE),
        Fraction(sample.fps).limit_denominator(1001),
        len(frames),
        sample.audio,
        sample.sample_rate_hz,
    )
    moments = np.linspace(0, len(frames) - 1, _MOMENTS).round().astype(int)
    rows = [np.concatenate([side[k] for k in moments], axis=1) for side in sides]
    return np.concatenate(rows, axis=0)
