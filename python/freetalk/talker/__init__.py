"""Speech and a face mesh in, a talking face out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from freetalk import _native
from freetalk._pretrained import PRETRAINED, find_weights
from freetalk._progress import Progress, StageProgress
from freetalk.animation import Animation
from freetalk.ats import Emotion, emotion_text
from freetalk.audio import Audio
from freetalk.geometry import Alignment, AlignOptions
from freetalk.mesh import Mesh, load_mesh
from freetalk.speech.voice_emotion import Keyframe
from freetalk.talker.face import PERFORMANCE, Face, as_audio
from freetalk.talker.live import Live, LiveFrame
from freetalk.talker.placement import Landmarks, Placement, find_face, place
from freetalk.talker.report import Report
from freetalk.talker.voice import Voice

AnimateOptions = _native.talker.AnimateOptions
FaceOptions = _native.talker.FaceOptions
LiveOptions = _native.talker.LiveOptions
TalkerOptions = _native.talker.TalkerOptions

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

HEAD_RESOLUTION = 128
"""Cells of a head's box along each axis, unless told otherwise."""

_PREPARATION = {"align": 0.25, "parts": 0.05, "operators": 0.6, "features": 0.1}
#: A mesh of more vertices is aligned before anything is computed of it: it may be a whole character.
_LARGE = 30_000
#: No head is longer than this (m): it has shoulders, or it is a body.
_LARGEST_HEAD_M = 0.6
_TOLD = ("unit", "up", "forward")


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
        return self._native.emotions

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
        return self._voice.read(as_audio(audio))

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
        landmarks: Landmarks | None = None,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Face:
        """Computes everything that depends on the mesh alone, once.

        The mesh's shape tells where its face is. Where it leaves that in doubt (a whole character, a head that is
        no human's, one that lies askew) and the extra ``faces`` is installed, pictures of the mesh are looked at;
        then only what is near the face moves.

        Args:
            mesh: face, head or character, or the path of an OBJ, PLY, OFF, STL or glTF file.
            landmarks: where the face is, which wins over any guess: 68 vertices (iBUG order), 68 points (68, 3) in
                the mesh's own unit and axes, or a file as ``freetalk mesh landmarks`` writes it.
            progress: a progress bar on a terminal, nothing, or a callback (done, total); whatever the callback
                raises ends the work.
            options: fields of ``FaceOptions``: unit, up, forward, engine ("stm", or "head" where the weights hold a
                parametric head: the one that fits the mesh best moves it), precision, memory_mb, follow_landmarks ("yes",
                "no", or "auto": as STM's weights say, always with "head") and cache_dir ("auto", the default here: the
                user's cache folder; None: no file is read or written).

        Returns:
            A face, for any number of clips, seeds and threads.

        Raises:
            ValueError: option out of range, a surface without area, or nothing on it looks like a face (unless
                landmarks, or unit, up and forward say where it is).
            RuntimeError: a file cannot be read.
        """
        wanted = FaceOptions(**_with_cache(options))
        with StageProgress(progress, _PREPARATION) as bar:
            return self._prepare(_mesh(mesh), wanted, landmarks, bar)

    def sample_identity(self, seed: int) -> torch.Tensor:
        """The code (D,) of a new identity of the weights' parametric head, the same for the same seed.

        Raises:
            ValueError: the weights have no head.
        """
        return self._native.sample_identity(seed)

    def prepare_head(
        self,
        z_id: torch.Tensor,
        *,
        resolution: int = HEAD_RESOLUTION,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> Face:
        """A head that no mesh was given for: the surface of an identity of the weights' parametric head.

        Args:
            z_id: (D,) code of the identity: of :meth:`sample_identity`, or of ``freetalk.head.fit_identity`` on
                the head in the weights' folder ``head``.
            resolution: cells along each axis of the head's box, a multiple of 128; more give a finer mesh.
            progress: as for :meth:`prepare`.
            options: fields of ``FaceOptions`` that concern no mesh: precision, cache_dir.

        Returns:
            A face in metres, +Y up, +Z out of the face, for any number of clips, seeds and threads.

        Raises:
            ValueError: the weights have no head, the code is of another size, an option is out of range.
            RuntimeError: the code has no surface.
        """
        wanted = FaceOptions(**_with_cache(options))
        with StageProgress(progress, {"features": 1.0}) as bar:
            native = self._native.prepare_head(
                z_id, resolution=resolution, options=wanted, progress=bar.update
            )
        return Face(native, self._voice)

    def _prepare(
        self, mesh: Mesh, options: FaceOptions, landmarks: Landmarks | None, bar: StageProgress
    ) -> Face:
        told = all(getattr(options, name) != "auto" for name in _TOLD)
        if landmarks is not None:
            return self._prepare_placed(place(mesh, landmarks), options, bar)
        if len(mesh.vertices) > _LARGE and not told:
            found = self.align(mesh, **{name: getattr(options, name) for name in _TOLD})
            if _doubtful(mesh, found):
                return self._prepare_placed(find_face(mesh, found), options, bar)
        native = self._native.prepare(mesh, options=options, progress=bar.update)
        if told or not _doubtful(mesh, native.report.alignment):
            return Face(native, self._voice)
        return self._prepare_placed(find_face(mesh, native.report.alignment), options, bar)

    def _prepare_placed(
        self, placement: Placement, options: FaceOptions, bar: StageProgress
    ) -> Face:
        upright = FaceOptions.from_dict(
            options.to_dict() | {"unit": "m", "up": "+y", "forward": "+z"}
        )
        native = self._native.prepare(
            placement.head(),
            options=upright,
            progress=bar.update,
            landmarks=placement.landmarks,
        )
        return Face(native, self._voice, placement)

    def animate(
        self,
        audio: Audio | str | os.PathLike[str],
        mesh: Mesh | str | os.PathLike[str],
        *,
        emotion: Emotion = "neutral",
        landmarks: Landmarks | None = None,
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
            landmarks: as for :meth:`prepare`.
            progress: as for :meth:`prepare`.
            options: further fields of ``TalkerOptions``: intensity, motion ("ats", or "facetalk" where the weights
                hold it), fps, seed, sampler ("ddim", "ddpm", "renoise", "dpmpp"), num_steps, eta, audio_guidance,
                affect_guidance, mouth_temperature, articulation (0.5 to 1.5: how far the mouth goes), blinks,
                head_motion, tolerance_mm, and those of :meth:`prepare`. What is None is as the weights say.

        Returns:
            round(duration * fps) frames in the mesh's own unit, axes and vertex order.

        Raises:
            ValueError: unknown emotion (the message lists the known), option out of range, empty input.
            RuntimeError: a file cannot be read.
        """
        sound, surface = as_audio(audio), _mesh(mesh)
        prepared, chosen = _options(self._voice.resolved(emotion, sound), options)
        with StageProgress(progress, _PREPARATION, PERFORMANCE) as bar:
            face = self._prepare(surface, prepared, landmarks, bar)
            animation, report = face.perform(sound, chosen, bar)
        self._report = _joined(face.report, report)
        return animation

    def animate_many(
        self,
        audio: Audio | str | os.PathLike[str],
        mesh: Mesh | str | os.PathLike[str],
        *,
        seeds: Sequence[int],
        emotion: Emotion = "neutral",
        landmarks: Landmarks | None = None,
        progress: bool | Progress | None = True,
        **options: Any,
    ) -> list[Animation]:
        """Several performances of one speech, their motion sampled together.

        Args:
            audio: as for :meth:`animate`.
            mesh: as for :meth:`animate`.
            seeds: one a performance.
            emotion: as for :meth:`animate`.
            landmarks: as for :meth:`prepare`.
            progress: as for :meth:`animate`.
            options: as for :meth:`animate`.

        Returns:
            One animation a seed: the motion is that of :meth:`animate` with the seed up to rounding, and every frame
            within ``tolerance_mm`` of decoding it.

        Raises:
            ValueError: as :meth:`animate`, or no seeds.
            RuntimeError: a file cannot be read.
        """
        sound, surface = as_audio(audio), _mesh(mesh)
        prepared, chosen = _options(self._voice.resolved(emotion, sound), options)
        with StageProgress(progress, _PREPARATION, PERFORMANCE) as bar:
            face = self._prepare(surface, prepared, landmarks, bar)
            animations, report = face.perform_many(sound, list(seeds), chosen, bar)
        self._report = _joined(face.report, report)
        return animations

    def live(self, face: Face, *, emotion: Emotion = "neutral", **options: Any) -> Live:
        """:meth:`Face.live`, on a face that this talker prepared.

        Raises:
            ValueError: as :meth:`Face.live`, or a face of other weights.
        """
        wanted = LiveOptions(emotion=emotion_text(emotion), **options)
        return Live(self._native.live(face._native, wanted), face._placement)


def _mesh(mesh: Mesh | str | os.PathLike[str]) -> Mesh:
    return mesh if isinstance(mesh, Mesh) else load_mesh(mesh)


def _with_cache(options: dict[str, Any]) -> dict[str, Any]:
    """Python keeps what is computed of a mesh in the user's cache folder unless told otherwise."""
    return {"cache_dir": "auto"} | options


def _options(emotion: Emotion, options: dict[str, Any]) -> tuple[FaceOptions, AnimateOptions]:
    """What concerns the mesh and what the performance; a ValueError names what neither knows."""
    wanted = TalkerOptions(emotion=emotion_text(emotion), **_with_cache(options)).to_dict()
    mine = FaceOptions().to_dict()
    return (
        FaceOptions.from_dict({name: value for name, value in wanted.items() if name in mine}),
        AnimateOptions.from_dict(
            {name: value for name, value in wanted.items() if name not in mine}
        ),
    )


def _joined(prepared: Report, performed: Report) -> Report:
    return replace(performed, timings=prepared.timings | performed.timings)


def _doubtful(mesh: Mesh, found: Alignment) -> bool:
    """Whether an alignment by shape alone may be wrong: no human face's shape, or a body's size."""
    vertices = np.asarray(mesh.vertices)[np.unique(np.asarray(mesh.faces))]
    longest = float(np.ptp(vertices, axis=0).max()) * found.to_canonical.scale
    return not found.face_like or longest > _LARGEST_HEAD_M
