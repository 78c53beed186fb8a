"""Which emotion a voice has, over time: a linear reading of the speech encoder's features.

Each window of a few seconds is described by the mean and the spread over time of each channel. Classes of equal
covariance (linear discriminant analysis; the covariance shrunk towards a sphere) give a probability each. What is
unsure, and what is like nothing that was learnt from, is neutral.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freetalk import _native
from freetalk._files import replacing, write_json
from freetalk.speech.encoder import SpeechEncoder
from freetalk.speech.features import encode_speech

FloatArray = npt.NDArray[np.float32]
#: Time in s, mixture of emotions, intensity: what ``emotion=`` of a talker takes.
Keyframe = tuple[float, dict[str, float], float]

FILE = "voice_emotion"
_RATE_HZ, _FPS = 16000, 30.0
_WINDOW_S, _HOP_S = 3.0, 1.5
_LEVEL = 0.05
_SHRINKAGE = 0.4
#: Least probability of an emotion that is shown; and how far a window may lie from all that was learnt from.
_SURE, _FARTHEST = 0.6, 0.995
_QUIET = 1e-4


def voice_features(encoder: SpeechEncoder, wave: FloatArray) -> FloatArray:
    """Mean and spread over time of the encoder's channels, (2 C,), of a voice (S,) at 16 kHz and any level."""
    level = float(np.sqrt(np.square(wave).mean()))
    sound = torch.from_numpy(np.ascontiguousarray(wave * (_LEVEL / (level + 1e-6)), np.float32))
    with torch.no_grad():
        features = encode_speech(encoder, sound, _FPS)
    return torch.cat([features.mean(0), features.std(0)]).cpu().numpy()


class VoiceEmotion:
    """Reads emotions from voices.

    Args:
        labels: K emotions.
        origin: (F,) mean of the features.
        spread: (F,) their standard deviation.
        weight: (K, F) and
        bias: (K,) of the scores, whose softmax are probabilities.
        centres: (K, F) of the classes, in units of the spread.
        farthest: mean square distance to the nearest centre from which a window is like nothing known.
    """

    def __init__(
        self,
        labels: Sequence[str],
        origin: FloatArray,
        spread: FloatArray,
        weight: FloatArray,
        bias: FloatArray,
        centres: FloatArray,
        farthest: float,
    ) -> None:
        self.labels = tuple(labels)
        self.origin, self.spread, self.weight, self.bias = origin, spread, weight, bias
        self.centres, self.farthest = centres, farthest

    @classmethod
    def fit(cls, features: FloatArray, labels: Sequence[str]) -> VoiceEmotion:
        """Learns from windows (N, F) and their N labels.

        Raises:
            ValueError: there are fewer than two labels, or one for fewer than two windows.
        """
        known = sorted(set(labels))
        which = np.array([known.index(label) for label in labels])
        counts = np.bincount(which)
        if len(known) < 2 or counts.min() < 2:
            raise ValueError("two emotions and two windows of each are needed at least")
        origin, spread = features.mean(0), features.std(0) + 1e-6
        scaled = ((features - origin) / spread).astype(np.float64)
        centres = np.stack([scaled[which == k].mean(0) for k in range(len(known))])
        within = scaled - centres[which]
        covariance = within.T @ within / len(scaled)
        sphere = np.trace(covariance) / len(covariance) * np.eye(len(covariance))
        covariance = (1 - _SHRINKAGE) * covariance + _SHRINKAGE * sphere
        weight = np.linalg.solve(covariance, centres.T).T
        bias = -0.5 * (centres * weight).sum(1)
        distance = np.square(scaled[:, None] - centres).mean(-1).min(1)
        farthest = float(np.quantile(distance, _FARTHEST))
        return cls(
            known,
            origin.astype(np.float32),
            spread.astype(np.float32),
            weight.astype(np.float32),
            bias.astype(np.float32),
            centres.astype(np.float32),
            farthest,
        )

    def softened(self, temperature: float) -> VoiceEmotion:
        """The same with scores divided by a temperature: more than 1 makes it less sure of itself."""
        return VoiceEmotion(
            self.labels,
            self.origin,
            self.spread,
            self.weight / np.float32(temperature),
            self.bias / np.float32(temperature),
            self.centres,
            self.farthest,
        )

    def probabilities(self, features: FloatArray) -> FloatArray:
        """(N, K) of windows (N, F)."""
        scaled = (features - self.origin) / self.spread
        scores = (scaled @ self.weight.T + self.bias).astype(np.float64)
        powers = np.exp(scores - scores.max(1, keepdims=True))
        return (powers / powers.sum(1, keepdims=True)).astype(np.float32)

    def knows(self, features: FloatArray) -> npt.NDArray[np.bool_]:
        """(N,) whether windows (N, F) are like those that were learnt from."""
        scaled = (features - self.origin) / self.spread
        near = np.square(scaled[:, None] - self.centres).mean(-1).min(1) <= self.farthest
        return np.asarray(near)

    def read(self, encoder: SpeechEncoder, wave: FloatArray) -> list[Keyframe]:
        """Emotions of a recording over time.

        Args:
            encoder: that the features were learnt with.
            wave: (S,) samples at 16 kHz.

        Returns:
            A keyframe each 1.5 s: time, mixture (neutral where it is unsure), and an intensity from 1 to 3 that
            grows with the certainty.
        """
        half, hop = round(_WINDOW_S * _RATE_HZ / 2), round(_HOP_S * _RATE_HZ)
        keys: list[Keyframe] = []
        first = min(half, len(wave) // 2)
        for middle in range(first, max(len(wave) - half, first) + 1, hop):
            window = wave[max(0, middle - half) : middle + half]
            keys.append((middle / _RATE_HZ, *self._emotion(encoder, window)))
        return keys

    def _emotion(
        self, encoder: SpeechEncoder, window: FloatArray
    ) -> tuple[dict[str, float], float]:
        neutral = {"neutral": 1.0}, 1.0
        if len(window) < _RATE_HZ // 2 or np.sqrt(np.square(window).mean()) < _QUIET:
            return neutral
        features = voice_features(encoder, window)[None]
        chances = dict(zip(self.labels, self.probabilities(features)[0].tolist(), strict=True))
        best = max(chances, key=lambda label: chances[label])
        if best == "neutral" or chances[best] < _SURE or not self.knows(features)[0]:
            return neutral
        share = (chances[best] - _SURE) / (1 - _SURE)
        return {
            best: round(chances[best], 3),
            "neutral": round(1 - chances[best], 3),
        }, 1 + 2 * share

    def save(self, folder: str | os.PathLike[str], about: dict[str, object]) -> None:
        """Writes ``voice_emotion.safetensors`` and, with what is said of its making, ``voice_emotion.json``."""
        tensors = {
            name: torch.from_numpy(np.ascontiguousarray(getattr(self, name)))
            for name in ("origin", "spread", "weight", "bias", "centres")
        }
        with replacing(Path(folder) / f"{FILE}.safetensors") as path:
            _native.core.save_safetensors(str(path), tensors)
        options = {"format": "freetalk-voice-emotion", "version": 1, "labels": list(self.labels)}
        write_json(Path(folder) / f"{FILE}.json", {**options, "farthest": self.farthest, **about})

    @classmethod
    def from_pretrained(cls, folder: str | os.PathLike[str]) -> VoiceEmotion:
        """Of a folder of weights.

        Raises:
            ValueError: the folder has none.
        """
        path = Path(folder) / f"{FILE}.json"
        if not path.is_file():
            raise ValueError(
                f"the weights in {folder} read no emotions from voices: {path.name} is missing"
            )
        about = json.loads(path.read_text())
        arrays = _native.core.load_safetensors(str(path.with_suffix(".safetensors")))
        values = {name: tensor.numpy() for name, tensor in arrays.items()}
        return cls(about["labels"], **values, farthest=float(about["farthest"]))
