"""What the command line reads of weights before anything heavy is imported."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from freetalk._pretrained import installed


def motion_options(folder: Path) -> dict[str, Any]:
    """Options of the landmark model: emotions, frames per second."""
    config: dict[str, Any] = json.loads((folder / "ats" / "config.json").read_text())
    return config["options"]


def shipped_emotions() -> list[str]:
    """Names that the first installed weights know; without any, the usual."""
    folder = next(installed(), None)
    emotions: list[str] = ["neutral", "happy", "angry"]
    return emotions if folder is None else motion_options(folder)["emotions"]


def check_emotion(text: str, folder: Path) -> None:
    """Makes sure that the weights know every emotion of a text, ``auto`` aside.

    What incomplete weights lack is said when they are loaded.

    Raises:
        ValueError: they do not, or it is no emotion.
    """
    from freetalk.ats import emotion_track
    from freetalk.talker.voice import AUTO

    if text != AUTO and (folder / "ats" / "config.json").is_file():
        emotions = motion_options(folder)["emotions"]
        emotion_track(text, emotions, intensity=1.0, num_frames=1, fps=30.0)


def check_intensity(given: float | None, folder: Path) -> None:
    """Makes sure that the weights know an intensity as strong.

    Raises:
        ValueError: they do not.
    """
    if given is None:
        return
    most = motion_options(folder).get("num_intensities", 3)
    if given > most:
        raise ValueError(f"--intensity {given:g}: these weights know 1 (slight) to {most} (strong)")
