"""A mesh made ready to speak."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import torch

from freetalk import _native
from freetalk._progress import Progress, StageProgress
from freetalk.animation import Animation, BlendShapes
from freetalk.ats import Emotion, emotion_text
from freetalk.audio import Audio, load_audio
from freetalk.mesh import Mesh
from freetalk.rig import FaceRig
from freetalk.talker.live import Live
from freetalk.talker.placement import Placement
from freetalk.talker.report import Report
from freetalk.talker.voice import Voice

AnimateOptions = _native.talker.AnimateOptions
FaceOptions = _native.talker.FaceOptions
LiveOptions = _native.talker.LiveOptions

PERFORMANCE = {"speech": 0.15, "motion": 0.45, "surface": 0.4}
"""Stages of a performance and their shares of its time."""


class Face:
    """A mesh made ready to speak by :meth:`Talker.prepare`; any number of threads may share it."""

    def __init__(self, native: Any, voice: Voice, placement: Placement | None = None) -> None:
        self._native = native
        self._voice = voice
        self._placement = placement
        prepared = native.report
        self._report = Report.of(prepared)
        if placement is not None:
            found = placement.alignment(prepared.alignment)
            notices = prepared.notices + placement.doubts(prepared.alignment)
            self._report = Report.of(prepared, alignment=found, notices=notices)

    @property
    def mesh(self) -> Mesh:
        """The mesh as it was given."""
        return self._native.mesh if self._placement is None else self._placement.mesh

    @property
    def options(self) -> FaceOptions:
        """How it was prepared."""
        return self._native.options

    @property
    def report(self) -> Report:
        """Alignment, parts, notices and timings of the preparation."""
        return self._report

    def num_frames(self, audio: Audio | str | os.PathLike[str], fps: float = 30.0) -> int:
        """Frames of an animation of this sound."""
        return self._native.num_frames(as_audio(audio), fps)

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
        sound = as_audio(audio)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = AnimateOptions(emotion=shown, **options)
        with StageProgress(progress, PERFORMANCE) as bar:
            return self.perform(sound, wanted, bar, out)

    def perform(
        self,
        audio: Audio,
        options: AnimateOptions,
        bar: StageProgress,
        out: torch.Tensor | None = None,
    ) -> tuple[Animation, Report]:
        """One performance with options and progress of the caller; see :meth:`animate_with_report`."""
        own = out if self._placement is None else None
        native, report = self._native.animate(audio, options=options, progress=bar.update, out=own)
        return self._finish(native, options, out), self._performed(report)

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
        sound = as_audio(audio)
        shown = emotion_text(self._voice.resolved(emotion, sound))
        wanted = AnimateOptions(emotion=shown, **options)
        with StageProgress(progress, PERFORMANCE) as bar:
            return self.perform_many(sound, list(seeds), wanted, bar, out)[0]

    def perform_many(
        self,
        audio: Audio,
        seeds: list[int],
        options: AnimateOptions,
        bar: StageProgress,
        out: torch.Tensor | None = None,
    ) -> tuple[list[Animation], Report]:
        """Several performances with options and progress of the caller; see :meth:`animate_many`."""
        own = out if self._placement is None else None
        natives, report = self._native.animate_many(
            audio, seeds=seeds, options=options, progress=bar.update, out=own
        )
        places = [None] * len(natives) if out is None else list(out)
        finished = [self._finish(native, options, to) for native, to in zip(natives, places)]
        return finished, self._performed(report)

    def _finish(self, native: Any, options: AnimateOptions, out: torch.Tensor | None) -> Animation:
        if self._placement is None:
            animation = Animation._wrap(native)
        else:
            animation = self._placement.animation(
                native, self._report.alignment, out, options.scratch_dir
            )
        animation._arkit_shapes = self.blend_shapes
        return animation

    def _performed(self, report: Any) -> Report:
        if self._placement is None:
            return Report.of(report)
        return Report.of(report, alignment=self._report.alignment)

    def rig(self, *, progress: bool | Progress | None = None) -> FaceRig:
        """The skin as named blend shapes, made when it is first asked for (seconds), then shared.

        Args:
            progress: True: a bar on a terminal; or a callback (done, total).

        Returns:
            The rig, in metres and the canonical frame, of the head alone where the face was looked for or told; kept in the cache folder for the next time.

        Raises:
            RuntimeError: the weights hold no poses to make it of (``rig_poses.safetensors``).
        """
        with StageProgress(progress, {"rig": 1.0}) as bar:
            return FaceRig(self._native.rig(bar.update))

    def blend_shapes(
        self, animation: Animation, *, progress: bool | Progress | None = None
    ) -> BlendShapes:
        """An animation of this face as ARKit's 51 shapes, for ``animation.save(path, rig=...)``.

        Args:
            animation: one that a face of this mesh made, so that it knows its landmarks.
            progress: as for :meth:`rig`.

        Returns:
            Targets in the mesh's own unit and axes, and weights in [0, 1].

        Raises:
            ValueError: the animation holds no landmarks.
            RuntimeError: as :meth:`rig`.
        """
        with StageProgress(progress, {"rig": 1.0}) as bar:
            shapes = self._native.blend_shapes(animation._native, bar.update)
        if self._placement is None:
            return shapes
        return BlendShapes(shapes.names, self._placement.spread(shapes.targets), shapes.weights)

    def live(self, *, emotion: Emotion = "neutral", **options: Any) -> Live:
        """A stream: speech in as it is spoken, frames out about half a second later.

        Args:
            emotion: as for :meth:`Talker.animate`; keyframes count from the stream's start.
            options: fields of ``LiveOptions``: intensity, seed, hop_s, lookahead_s, sampler, num_steps ...

        Raises:
            ValueError: unknown emotion, option out of range.
        """
        wanted = LiveOptions(emotion=emotion_text(emotion), **options)
        return Live(_native.talker.Live(self._native, wanted), self._placement)


def as_audio(audio: Audio | str | os.PathLike[str]) -> Audio:
    """The sound, read if it is a path."""
    return audio if isinstance(audio, Audio) else load_audio(audio)
