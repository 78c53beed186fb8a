"""``emotion="auto"``: what a voice sounds like becomes what the face shows."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np

from freetalk.ats import Emotion
from freetalk.audio import Audio, resample
from freetalk.speech import SAMPLE_RATE_HZ, SpeechEncoder
from freetalk.speech.voice_emotion import Keyframe, VoiceEmotion

#: The emotion that is read from the voice.
AUTO = "auto"


class Voice:
    """Reads emotions with the weights of a folder, which are loaded when they are first asked for.

    Args:
        folder: of weights.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @cached_property
    def _models(self) -> tuple[VoiceEmotion, SpeechEncoder]:
        reader = VoiceEmotion.from_pretrained(self.folder)
        return reader, SpeechEncoder.from_pretrained(self.folder / "speech").eval()

    def read(self, audio: Audio) -> list[Keyframe]:
        """Keyframes of the emotion of a recording; neutral where it is unsure.

        Raises:
            ValueError: the weights cannot tell.
        """
        reader, encoder = self._models
        sound = resample(audio, SAMPLE_RATE_HZ)
        return reader.read(encoder, np.asarray(sound.samples, dtype=np.float32))

    def resolved(self, emotion: Emotion, audio: Audio) -> Emotion:
        """The emotion that was asked for, or that of the voice."""
        return self.read(audio) if emotion == AUTO else emotion


def summary(keys: list[Keyframe]) -> str:
    """Keyframes as one line: times, emotions that are more than half of the mixture, intensities."""
    shown: list[tuple[str, str]] = []
    for time_s, mixture, intensity in keys:
        name = max(mixture, key=lambda label: mixture[label])
        if not shown or shown[-1][0] != name:
            shown.append(
                (
                    name,
                    f"{time_s:.1f} s {name}" + ("" if name == "neutral" else f" {intensity:.1f}"),
                )
            )
    return ", ".join(text for _, text in shown) or "neutral"
