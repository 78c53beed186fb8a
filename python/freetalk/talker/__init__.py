"""Speech and a face mesh in, a talking face out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import torch

from freetalk import _native
from freetalk._pretrained import PRETRAINED, find_weights
from freetalk._progress import Progress, StageProgress
from freetalk.animation import Animation
from freetalk.ats import Emotion, emotion_text
from freetalk.audio import Audio, load_audio
from freetalk.geometry import Alignment, AlignOptions
from freetalk.mesh import Mesh, load_mesh
from freetalk.rig import FaceRig
from freetalk.speech.voice_emotion import Keyframe
from freetalk.talker.live import Live, LiveFrame
from freetalk.talker.voice import Voice

AnimateOptions = _native.talker.AnimateOptions
FaceOptions = _native.talker.FaceOptions
LiveOptions = _native.talker.LiveOptions
TalkerOptions = _native.talker.TalkerOptions
Report = _native.talker.Report

__all__ = [
    "PRETRAINED",
    "AnimateOptions",
    "Face",
    "FaceOptions",
    "Live",
    "LiveFrame",
    "LiveOptions",
    "Report",
    "Talker",
    "TalkerOptions",
]

_PREPARATION = {"align": 0.25, "parts": 0.05, "operators": 0.6, "features": 0.1}
_PERFORMANCE = {"speech": 0.15, "motion": 0.45, "surface": 0.4}


class Talker:
    """The weights of the whole pipeline: load once, share between threads, animate any mesh with any speech.

    Use :meth:`from_pretrained`. :meth:`animate` does everything in one call; :meth:`prepare` does what depends on
    the mesh alone once, for many clips. After :meth:`animate`, :attr:`report` says what was guessed and measured.
    """

    def __init__(self, native: Any, voice: Voice) -> None:
        self._native = native
        self._voice = voice
        self._report: Report | None = None

    @classmethod
    def from_pretrained(
        cls, name_or_dir: str | os.PathLike[str] = "open-small", *, device: str | None = None
    ) -> Talker:
        """Loads weights.

        Args:
            name_or_dir: a folder with talker.json, the name of weights that ship with the package, or
                ``owner/name`` on huggingface.co (``freetalk.hub`` publishes there).
            device: such as "cpu" or "cuda"; by default the GPU if there is one.

        Raises:
            ValueError: no such weights, or the folder lacks a stage; the message says which.
            RuntimeError: a file is missing, broken or does not fit, or the hub cannot be reached.
        """
        folder = find_weights(name_or_dir)
        return cls(_native.talker.Talker.from_pretrained(folder, device), Voice(folder))

    @property
    def emotions(self) -> list[str]:
        """Names that ``emotion=`` accepts, beside aliases."""
        emotions: list[str] = self._native.emotions
        return emotions

    @property
    def max_intensity(self) -> float:
        """The strongest ``intensity=``; the slightest is 1."""
        return self._native.max_intensity

    @property
    def device(self) -> str:
        """Where the models are."""
        return self._native.device

    @property
    def report(self) -> Report | None:
        """Alignment, parts, notices and timings of the last :meth:`animate` of this object, by any thread."""
        return self._report

    def read_emotion(self, audio: Audio | str | os.PathLike[str]) -> list[Keyframe]:
        """The emotion of a voice over time, as ``emotion="auto"`` shows it; neutral where it is unsure.

        Raises:
            ValueError: the weights have no ``voice_emotion.json``.
            RuntimeError: the file cannot be read.
        """
        return self._voice.read(_audio(audio))

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

    def prepare(
        self,
        mesh: Mesh | str | os.PathLike[str],
        *,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Face:
        """Computes everything that depends on the mesh alone, once.

        Args:
            mesh: face or head, or the path of an OBJ, PLY, OFF, STL or glTF file.
            progress: a progress bar on a terminal, nothing, or a callback (done, total); whatever the callback
                raises ends the work.
            options: fields of ``FaceOptions``: unit, up, forward, precision, memory_mb and cache_dir ("auto", the
                default here: the user's cache folder; None: no file is read or written).

        Returns:
            A face, for any number of clips, seeds and threads.

        Raises:
            ValueError: option out of range, or a surface without area.
            RuntimeError: a file cannot be read.
        """
        wanted = FaceOptions(**_with_cache(options))
        with StageProgress(progress, _PREPARATION) as bar:
            native = self._native.prepare(_mesh(mesh), options=wanted, progress=bar.update)
            return Face(native, self._voice)

    def animate(
        self,
        audio: Audio | str | os.PathLike[str],
        mesh: Mesh | str | os.PathLike[str],
        *,
        emotion: Emotion = "neutral",
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Animation:
        """Makes a mesh speak: :meth:`prepare` and :meth:`Face.animate` in one call.

        Args:
            audio: speech, or the path of a recording.
            mesh: face or head, or the path of an OBJ, PLY, OFF, STL or glTF file.
            emotion: a name ``"happy"``; a mixture ``{"happy": 0.7, "surprise": 0.3}``; or keyframes
                ``[(0.0, "neutral", 1), (2.5, {"happy": 0.7, "surprise": 0.3}, 2.5)]`` of seconds,
                mixture and intensity, linear in between; or ``"auto"``: what the voice sounds like.
            progress: as for :meth:`prepare`.
            options: further fields of ``TalkerOptions``: intensity, fps, seed, sampler ("ddim", "ddpm",
                "dpmpp"), num_steps, eta, audio_guidance, affect_guidance, mouth_temperature, blinks, tolerance_mm,
                and those of :meth:`prepare`. What is None is as the weights say.

        Returns:
            round(duration * fps) frames in the mesh's own unit, axes and vertex order.

        Raises:
            ValueError: unknown emotion (the message lists the known), option out of range, empty input.
            RuntimeError: a file cannot be read.
        """
        sound, surface = _audio(audio), _mesh(mesh)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = TalkerOptions(emotion=shown, **_with_cache(options))
        with StageProgress(progress, _PREPARATION, _PERFORMANCE) as bar:
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
            One animation a seed: the motion is that of :meth:`animate` with the seed up to rounding, and every frame
            within ``tolerance_mm`` of decoding it.

        Raises:
            ValueError: as :meth:`animate`, or no seeds.
            RuntimeError: a file cannot be read.
        """
        sound, surface = _audio(audio), _mesh(mesh)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = TalkerOptions(emotion=shown, **_with_cache(options))
        with StageProgress(progress, _PREPARATION, _PERFORMANCE) as bar:
            natives, self._report = self._native.animate_many(
                sound, surface, seeds=list(seeds), options=wanted, progress=bar.update
            )
        return [Animation._wrap(native) for native in natives]

    def live(self, face: Face, *, emotion: Emotion = "neutral", **options: Any) -> Live:
        """:meth:`Face.live`, on a face that this talker prepared.

        Raises:
            ValueError: as :meth:`Face.live`, or a face of other weights.
        """
        wanted = LiveOptions(emotion=emotion_text(emotion), **options)
        return Live(self._native.live(face._native, wanted))


class Face:
    """A mesh made ready to speak by :meth:`Talker.prepare`; any number of threads may share it."""

    def __init__(self, native: Any, voice: Voice) -> None:
        self._native = native
        self._voice = voice

    @property
    def mesh(self) -> Mesh:
        """The mesh as it was given."""
        return self._native.mesh

    @property
    def options(self) -> FaceOptions:
        """How it was prepared."""
        return self._native.options

    @property
    def report(self) -> Report:
        """Alignment, parts, notices and timings of the preparation."""
        return self._native.report

    def num_frames(self, audio: Audio | str | os.PathLike[str], fps: float = 30.0) -> int:
        """Frames of an animation of this sound."""
        return self._native.num_frames(_audio(audio), fps)

    def animate(
        self,
        audio: Audio | str | os.PathLike[str],
        *,
        emotion: Emotion = "neutral",
        out: torch.Tensor | None = None,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Animation:
        """One performance.

        Args:
            audio: speech, or the path of a recording.
            emotion: as for :meth:`Talker.animate`.
            out: (T, V, 3) contiguous float32 tensor on the CPU to fill, T as :meth:`num_frames` says; it becomes the
                animation's displacements.
            progress: as for :meth:`Talker.prepare`.
            options: fields of ``AnimateOptions``, see :meth:`Talker.animate`.

        Returns:
            T frames in the mesh's own unit, axes and vertex order; its metadata holds what was found.

        Raises:
            ValueError: unknown emotion, option out of range, empty input, ``out`` of another form.
            RuntimeError: a file cannot be read.
        """
        return self.animate_with_report(
            audio, emotion=emotion, out=out, progress=progress, **options
        )[0]

    def animate_with_report(
        self,
        audio: Audio | str | os.PathLike[str],
        *,
        emotion: Emotion = "neutral",
        out: torch.Tensor | None = None,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> tuple[Animation, Report]:
        """As :meth:`animate`, with notices, decoded frames and timings beside."""
        sound = _audio(audio)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = AnimateOptions(emotion=shown, **options)
        with StageProgress(progress, _PERFORMANCE) as bar:
            native, report = self._native.animate(
                sound, options=wanted, progress=bar.update, out=out
            )
        return Animation._wrap(native), report

    def animate_many(
        self,
        audio: Audio | str | os.PathLike[str],
        *,
        seeds: Sequence[int],
        emotion: Emotion = "neutral",
        out: torch.Tensor | None = None,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> list[Animation]:
        """Several performances of one speech, their motion sampled together.

        Args:
            audio: as for :meth:`animate`.
            seeds: one a performance.
            emotion: as for :meth:`animate`.
            out: (seeds, T, V, 3), else as for :meth:`animate`.
            progress: as for :meth:`animate`.
            options: as for :meth:`animate`.

        Returns:
            One animation a seed: the motion is that of :meth:`animate` up to rounding, and every frame within
            ``tolerance_mm`` of decoding it.

        Raises:
            ValueError: as :meth:`animate`, or no seeds.
            RuntimeError: a file cannot be read.
        """
        sound = _audio(audio)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = AnimateOptions(emotion=shown, **options)
        with StageProgress(progress, _PERFORMANCE) as bar:
            natives, _ = self._native.animate_many(
                sound, seeds=list(seeds), options=wanted, progress=bar.update, out=out
            )
        return [Animation._wrap(native) for native in natives]

    def rig(self, *, progress: bool | Progress | None = None) -> FaceRig:
        """The skin as named blend shapes, made when it is first asked for (seconds), then shared.

        Args:
            progress: True: a bar on a terminal; or a callback (done, total).

        Returns:
            The rig, in metres and the canonical frame; kept in the cache folder for the next time.

        Raises:
            RuntimeError: the weights hold no poses to make it of (``rig_poses.safetensors``).
        """
        with StageProgress(progress, {"rig": 1.0}) as bar:
            return FaceRig(self._native.rig(bar.update))

    def live(self, *, emotion: Emotion = "neutral", **options: Any) -> Live:
        """A stream: speech in as it is spoken, frames out about half a second later.

        Args:
            emotion: as for :meth:`Talker.animate`; keyframes count from the stream's start.
            options: fields of ``LiveOptions``: intensity, seed, hop_s, lookahead_s, sampler, num_steps ...

        Raises:
            ValueError: unknown emotion, option out of range.
        """
        wanted = LiveOptions(emotion=emotion_text(emotion), **options)
        return Live(_native.talker.Live(self._native, wanted))


def _mesh(mesh: Mesh | str | os.PathLike[str]) -> Mesh:
    return mesh if isinstance(mesh, Mesh) else load_mesh(mesh)


def _audio(audio: Audio | str | os.PathLike[str]) -> Audio:
    return audio if isinstance(audio, Audio) else load_audio(audio)


def _with_cache(options: dict[str, Any]) -> dict[str, Any]:
    """Python keeps what is computed of a mesh in the user's cache folder unless told otherwise."""
    return {"cache_dir": "auto"} | options
