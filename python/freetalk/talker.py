"""Speech and a face mesh in, a talking face out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from freetalk import _native
from freetalk._pretrained import PRETRAINED, installed
from freetalk.animation import Animation
from freetalk.ats import Emotion, emotion_text
from freetalk.audio import Audio, load_audio
from freetalk.geometry import Alignment, AlignOptions
from freetalk.mesh import Mesh, load_mesh

TalkerOptions = _native.talker.TalkerOptions
Report = _native.talker.Report

Progress = Callable[[float, float], None]

__all__ = ["PRETRAINED", "Report", "Talker", "TalkerOptions"]

_SHARES = {"align": 0.05, "operators": 0.15, "speech": 0.10, "motion": 0.35, "surface": 0.35}


class Talker:
    """The whole pipeline: load once, animate any mesh with any speech.

    Use :meth:`from_pretrained`. After :meth:`animate`, :attr:`report` says what was guessed and measured.
    """

    def __init__(self, native: Any) -> None:
        self._native = native
        self._report: Report | None = None

    @classmethod
    def from_pretrained(
        cls, name_or_dir: str | os.PathLike[str] = "open-small", *, device: str | None = None
    ) -> Talker:
        """Loads weights.

        Args:
            name_or_dir: a folder with talker.json, or the name of weights that ship with the package.
            device: such as "cpu" or "cuda"; by default the GPU if there is one.

        Raises:
            ValueError: no such weights.
            RuntimeError: a file is missing, broken or does not fit.
        """
        folder = Path(name_or_dir)
        if not folder.is_dir() and (PRETRAINED / folder / "talker.json").is_file():
            folder = PRETRAINED / folder
        if not folder.is_dir():
            known = ", ".join(file.name for file in installed())
            raise ValueError(
                f"no weights '{name_or_dir}': neither a folder nor one of: {known or 'none shipped'}"
            )
        return cls(_native.talker.Talker.from_pretrained(folder, device))

    @property
    def emotions(self) -> list[str]:
        """Names that ``emotion=`` accepts, beside aliases."""
        emotions: list[str] = self._native.emotions
        return emotions

    @property
    def device(self) -> str:
        """Where the models are."""
        return self._native.device

    @property
    def report(self) -> Report | None:
        """Alignment, parts, notices and timings of the last :meth:`animate`."""
        return self._report

    def align(
        self,
        mesh: Mesh | str | os.PathLike[str],
        *,
        unit: str = "auto",
        up: str = "auto",
        forward: str = "auto",
    ) -> Alignment:
        """How a mesh lies relative to the canonical frame: unit, axes, similarity, residual."""
        options = AlignOptions(unit=unit, up=up, forward=forward)
        return self._native.align(_mesh(mesh), options)

    def animate(
        self,
        audio: Audio | str | os.PathLike[str],
        mesh: Mesh | str | os.PathLike[str],
        *,
        emotion: Emotion = "neutral",
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Animation:
        """Makes a mesh speak.

        Args:
            audio: speech, or the path of a recording.
            mesh: face or head, or the path of an OBJ, PLY, OFF, STL or glTF file.
            emotion: a name ``"happy"``; a mixture ``{"happy": 0.7, "surprise": 0.3}``; or keyframes
                ``[(0.0, "neutral", 1), (2.5, {"happy": 0.7, "surprise": 0.3}, 2.5)]`` of seconds,
                mixture and intensity, linear in between.
            progress: a progress bar on a terminal, nothing, or a callback (done, total).
            options: further fields of ``TalkerOptions``: intensity, fps, seed, sampler ("ddim", "ddpm",
                "dpmpp"), num_steps, eta, audio_guidance, affect_guidance, mouth_temperature, blinks, precision,
                unit, up, forward ...

        Returns:
            round(duration * fps) frames in the mesh's own unit, axes and vertex order.

        Raises:
            ValueError: unknown emotion (the message lists the known), option out of range, empty input.
            RuntimeError: a file cannot be read.
        """
        wanted = TalkerOptions(emotion=emotion_text(emotion), **options)
        sound = audio if isinstance(audio, Audio) else load_audio(audio)
        surface = _mesh(mesh)
        with _Progress(progress) as bar:
            native, self._report = self._native.animate(sound, surface, wanted, bar.update)
        return Animation._wrap(native)

    def animate_many(
        self,
        audio: Audio | str | os.PathLike[str],
        mesh: Mesh | str | os.PathLike[str],
        *,
        seeds: Sequence[int],
        emotion: Emotion = "neutral",
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> list[Animation]:
        """Several performances of one speech, their motion sampled together.

        Args:
            audio: as for :meth:`animate`.
            mesh: as for :meth:`animate`.
            seeds: one a performance.
            emotion: as for :meth:`animate`.
            progress: as for :meth:`animate`.
            options: as for :meth:`animate`.

        Returns:
            One animation a seed, equal to that of :meth:`animate` with the seed up to rounding.

        Raises:
            ValueError: as :meth:`animate`, or no seeds.
            RuntimeError: a file cannot be read.
        """
        wanted = TalkerOptions(emotion=emotion_text(emotion), **options)
        sound = audio if isinstance(audio, Audio) else load_audio(audio)
        surface = _mesh(mesh)
        with _Progress(progress) as bar:
            natives, self._report = self._native.animate_many(
                sound, surface, seeds=list(seeds), options=wanted, progress=bar.update
            )
        return [Animation._wrap(native) for native in natives]


def _mesh(mesh: Mesh | str | os.PathLike[str]) -> Mesh:
    return mesh if isinstance(mesh, Mesh) else load_mesh(mesh)


class _Progress:
    """Stages of the native pipeline as one bar or one callback."""

    def __init__(self, progress: bool | Progress | None) -> None:
        self._callback = progress if callable(progress) else None
        self._bar: Any = None
        if progress is True:
            from tqdm import tqdm

            self._bar = tqdm(total=1.0, desc="animating", leave=False, disable=None)
            self._bar.bar_format = "{desc}: {percentage:3.0f}%|{bar}| {elapsed}"

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def update(self, stage: str, fraction: float) -> None:
        """Called by the native pipeline."""
        names = list(_SHARES)
        before = sum(_SHARES[name] for name in names[: names.index(stage)])
        done = before + _SHARES[stage] * fraction
        if self._callback is not None:
            self._callback(done, 1.0)
        if self._bar is not None:
            self._bar.set_description(stage, refresh=False)
            self._bar.n = done
            self._bar.refresh()
