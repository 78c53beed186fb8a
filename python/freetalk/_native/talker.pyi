from __future__ import annotations
import collections.abc
import freetalk._native.animation
import freetalk._native.audio
import freetalk._native.geometry
import freetalk._native.mesh
import freetalk._native.rig
import numpy
import numpy.typing
import os
import torch
import typing

__all__: list[str] = [
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

class FaceOptions:
    """
    How a face is prepared.
    """

    __hash__: typing.ClassVar[None] = None
    cache_dir: typing.Any
    engine: typing.Any
    follow_landmarks: typing.Any
    forward: typing.Any
    memory_mb: typing.Any
    precision: typing.Any
    unit: typing.Any
    up: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> FaceOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: FaceOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class AnimateOptions:
    """
    One performance.
    """

    __hash__: typing.ClassVar[None] = None
    affect_guidance: typing.Any
    articulation: typing.Any
    audio_guidance: typing.Any
    blinks: typing.Any
    emotion: typing.Any
    eta: typing.Any
    fps: typing.Any
    head_motion: typing.Any
    intensity: typing.Any
    motion: typing.Any
    mouth_temperature: typing.Any
    num_steps: typing.Any
    sampler: typing.Any
    scratch_dir: typing.Any
    seed: typing.Any
    tolerance_mm: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> AnimateOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: AnimateOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class TalkerOptions:
    """
    How a face is prepared and animated.
    """

    __hash__: typing.ClassVar[None] = None
    affect_guidance: typing.Any
    articulation: typing.Any
    audio_guidance: typing.Any
    blinks: typing.Any
    cache_dir: typing.Any
    emotion: typing.Any
    engine: typing.Any
    eta: typing.Any
    follow_landmarks: typing.Any
    forward: typing.Any
    fps: typing.Any
    head_motion: typing.Any
    intensity: typing.Any
    memory_mb: typing.Any
    motion: typing.Any
    mouth_temperature: typing.Any
    num_steps: typing.Any
    precision: typing.Any
    sampler: typing.Any
    scratch_dir: typing.Any
    seed: typing.Any
    tolerance_mm: typing.Any
    unit: typing.Any
    up: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> TalkerOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: TalkerOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Report:
    """
    What was found, guessed and measured on the way.
    """
    @property
    def alignment(self) -> freetalk._native.geometry.Alignment: ...
    @property
    def decode_error(self) -> float:
        """
        Checked mean error of interpolated frames, as a share of the mean motion.
        """
    @property
    def decode_error_mm(self) -> float:
        """
        Checked largest error of interpolated frames.
        """
    @property
    def decoded_frames(self) -> int:
        """
        Frames that STM decoded; the others are interpolated.
        """
    @property
    def notices(self) -> list[str]: ...
    @property
    def num_frames(self) -> int:
        """
        Frames of all performances.
        """
    @property
    def parts(self) -> str: ...
    @property
    def timings(self) -> dict: ...

class Face:
    """
    A mesh made ready to speak.
    """
    @staticmethod
    def num_frames(
        audio: freetalk._native.audio.Audio, fps: typing.SupportsFloat | typing.SupportsIndex
    ) -> int: ...
    def animate(
        self,
        audio: freetalk._native.audio.Audio,
        *,
        options: AnimateOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
        out: torch.Tensor | None = None,
    ) -> tuple[freetalk._native.animation.Animation, Report]: ...
    def animate_many(
        self,
        audio: freetalk._native.audio.Audio,
        *,
        seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        options: AnimateOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
        out: torch.Tensor | None = None,
    ) -> tuple[list[freetalk._native.animation.Animation], Report]: ...
    def blend_shapes(
        self,
        animation: freetalk._native.animation.Animation,
        progress: collections.abc.Callable[[str, float], None] | None = None,
    ) -> freetalk._native.animation.BlendShapes: ...
    def rig(
        self, progress: collections.abc.Callable[[str, float], None] | None = None
    ) -> freetalk._native.rig.FaceRig: ...
    @property
    def mesh(self) -> freetalk._native.mesh.Mesh: ...
    @property
    def options(self) -> FaceOptions: ...
    @property
    def report(self) -> Report: ...

class LiveOptions:
    """
    A live stream.
    """

    __hash__: typing.ClassVar[None] = None
    affect_guidance: typing.Any
    articulation: typing.Any
    audio_guidance: typing.Any
    blinks: typing.Any
    context_s: typing.Any
    emotion: typing.Any
    emotion_ramp_s: typing.Any
    fade_s: typing.Any
    head_motion: typing.Any
    hop_s: typing.Any
    intensity: typing.Any
    lookahead_s: typing.Any
    mouth_temperature: typing.Any
    num_steps: typing.Any
    redo_frames: typing.Any
    rig: typing.Any
    sampler: typing.Any
    seed: typing.Any
    window_frames: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> LiveOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: LiveOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class LiveFrame:
    """
    A frame of a live stream.
    """
    @property
    def head(self) -> torch.Tensor | None:
        """
        (4, 4) float64 rigid motion of the head, metres, canonical frame; None without head_motion.
        """
    @property
    def index(self) -> int: ...
    @property
    def landmarks(self) -> torch.Tensor:
        """
        (68, 3) float32 displacements, metres, canonical frame.
        """
    @property
    def time_s(self) -> float:
        """
        Of the speech that it belongs to.
        """
    @property
    def weights(self) -> torch.Tensor | None:
        """
        (W,) float32 in [0, 1] of the face's rig, None without.
        """

class Live:
    """
    Speech in as it is spoken, frames out.
    """
    def __init__(self, face: Face, options: LiveOptions = ...) -> None: ...
    def decode(self, frame: LiveFrame) -> torch.Tensor: ...
    def finish(self) -> list[LiveFrame]: ...
    def head(self, frame: LiveFrame) -> torch.Tensor | None: ...
    def push(
        self, samples: typing.Annotated[numpy.typing.ArrayLike, numpy.float32]
    ) -> list[LiveFrame]: ...
    def reset(self) -> None: ...
    def set_emotion(
        self, emotion: str, intensity: typing.SupportsFloat | typing.SupportsIndex | None = None
    ) -> None: ...
    @property
    def fps(self) -> float: ...
    @property
    def latency_s(self) -> float: ...
    @property
    def num_held(self) -> int: ...
    @property
    def options(self) -> LiveOptions: ...

class Talker:
    """
    The weights, shared by any number of threads.
    """
    @staticmethod
    def from_pretrained(
        directory: os.PathLike | str | bytes, device: str | None = None
    ) -> Talker: ...
    def align(
        self,
        mesh: freetalk._native.mesh.Mesh,
        options: freetalk._native.geometry.AlignOptions = ...,
    ) -> freetalk._native.geometry.Alignment: ...
    def animate(
        self,
        audio: freetalk._native.audio.Audio,
        mesh: freetalk._native.mesh.Mesh,
        options: TalkerOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
    ) -> tuple[freetalk._native.animation.Animation, Report]: ...
    def animate_many(
        self,
        audio: freetalk._native.audio.Audio,
        mesh: freetalk._native.mesh.Mesh,
        *,
        seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        options: TalkerOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
    ) -> tuple[list[freetalk._native.animation.Animation], Report]: ...
    def live(self, face: Face, options: LiveOptions = ...) -> Live: ...
    def prepare(
        self,
        mesh: freetalk._native.mesh.Mesh,
        *,
        options: FaceOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
        landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] = ...,
    ) -> Face: ...
    def prepare_head(
        self,
        z_id: torch.Tensor,
        *,
        resolution: typing.SupportsInt | typing.SupportsIndex,
        options: FaceOptions = ...,
        progress: collections.abc.Callable[[str, float], None] | None = None,
    ) -> Face: ...
    def sample_identity(self, seed: typing.SupportsInt | typing.SupportsIndex) -> torch.Tensor: ...
    @property
    def device(self) -> str: ...
    @property
    def emotions(self) -> list[str]: ...
    @property
    def max_intensity(self) -> float: ...
