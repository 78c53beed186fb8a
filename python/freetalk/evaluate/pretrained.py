"""A folder of weights, as training writes it and the package ships it, opened for evaluation."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from freetalk.ats import Ats, GenerateOptions, generate
from freetalk.speech import SpeechEncoder, encode_speech
from freetalk.stm import Stm

FloatArray = npt.NDArray[np.float32]


class SpeechToMotion:
    """Speech encoder and ATS on one device: samples in, landmark motion out.

    Args:
        encoder: folder of the speech encoder.
        ats: folder of the audio-to-landmarks stage.
        sampling: fields of ``GenerateOptions``.
        device: where it runs; ``None``: a GPU where there is one.
    """

    def __init__(
        self,
        encoder: Path,
        ats: Path,
        sampling: Mapping[str, object],
        device: torch.device | str | None = None,
    ) -> None:
        self.device = torch.device(device or ("cuda" if torch.cuda.is_available() else "cpu"))
        self.encoder = SpeechEncoder.from_pretrained(encoder).to(self.device).eval()
        self.ats = Ats.from_pretrained(ats).to(self.device).eval()
        self.options = GenerateOptions.from_dict(dict(sampling))
        self.fps = float(self.ats.options.fps)
        self.emotions = tuple(self.ats.options.emotions)

    @classmethod
    def of(cls, directory: str | Path, num_steps: int | None = None) -> SpeechToMotion:
        """Of a folder with ``speech`` and ``ats``.

        Args:
            directory: the folder; its ``talker.json`` says how the weights want to be sampled.
            num_steps: denoising steps; by default those of the weights.
        """
        own = _sampling(directory)
        if num_steps is not None:
            own["num_steps"] = num_steps
        return cls(Path(directory) / "speech", Path(directory) / "ats", own)

    def features(self, wave: FloatArray) -> torch.Tensor:
        """Speech features at the motion's frames, (T, C), on the device."""
        return encode_speech(self.encoder, torch.from_numpy(np.array(wave)), self.fps)

    def motion(
        self,
        features: torch.Tensor,
        emotion: str = "neutral",
        intensity: float = 1.0,
        seed: int = 0,
    ) -> FloatArray:
        """Landmark displacements, (T, 68, 3) m."""
        mixture = torch.zeros(len(self.emotions), device=self.device)
        mixture[self.emotions.index(emotion)] = 1.0
        with torch.no_grad():
            motion = generate(
                self.ats,
                features,
                emotion=mixture,
                intensity=intensity,
                options=self.options,
                seed=seed,
            )
        result: FloatArray = motion.cpu().numpy()
        return result


def _sampling(directory: str | Path) -> dict[str, Any]:
    """How the weights want to be sampled, as their ``talker.json`` says."""
    description = Path(directory) / "talker.json"
    if not description.is_file():
        return {}
    own: dict[str, Any] = json.loads(description.read_text()).get("generate", {})
    return own


def load_stm(directory: str | Path) -> Stm:
    """The landmarks-to-mesh network of a folder of weights."""
    return Stm.from_pretrained(Path(directory) / "stm").eval()
