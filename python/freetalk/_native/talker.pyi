from __future__ import annotations
import collections.abc
import freetalk._native.animation
import freetalk._native.audio
import freetalk._native.geometry
import freetalk._native.mesh
import os
import typing

__all__: list[str] = ["Report", "Talker", "TalkerOptions"]

class TalkerOptions:
    """
    How a face is animated.
    """

    __hash__: typing.ClassVar[None] = None
    affect_guidance: typing.Any
    audio_guidance: typing.Any
    blinks: typing.Any
    cache_dir: typing.Any
    emotion: typing.Any
    eta: typing.Any
    forward: typing.Any
    fps: typing.Any
    intensity: typing.Any
    memory_mb: typing.Any
    mouth_temperature: typing.Any
    num_steps: typing.Any
    precision: typing.Any
    sampler: typing.Any
    seed: typing.Any
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
    def notices(self) -> list[str]: ...
    @property
    def parts(self) -> str: ...
    @property
    def timings(self) -> dict: ...

class Talker:
    """
    The whole pipeline behind one object.
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
    @property
    def device(self) -> str: ...
    @property
    def emotions(self) -> list[str]: ...
