from __future__ import annotations
import collections.abc
import torch
import typing

__all__: list[str] = [
    "AtsImpl",
    "AtsOptions",
    "GenerateOptions",
    "articulate",
    "emotion_track",
    "generate",
    "parse_emotion",
    "window_starts",
]

class AtsOptions:
    """
    Options of the ATS denoiser [FreeTalk 3.1].
    """

    __hash__: typing.ClassVar[None] = None
    activation: typing.Any
    attention_start: typing.Any
    audio_dim: typing.Any
    band_radius: typing.Any
    beta_end: typing.Any
    beta_start: typing.Any
    d_model: typing.Any
    dropout: typing.Any
    emotions: typing.Any
    ff_dim: typing.Any
    fps: typing.Any
    known_prefix: typing.Any
    max_frames: typing.Any
    norm_first: typing.Any
    num_heads: typing.Any
    num_intensities: typing.Any
    num_layers: typing.Any
    num_train_steps: typing.Any
    schedule: typing.Any
    trained_frames: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> AtsOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: AtsOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class AtsImpl:
    def __init__(self, options: AtsOptions) -> None: ...
    def denormalize(self, motion: torch.Tensor) -> torch.Tensor: ...
    def forward(
        self,
        x: torch.Tensor,
        timestep: torch.Tensor,
        *,
        audio: torch.Tensor,
        emotion: torch.Tensor,
        intensity: torch.Tensor,
        valid: torch.Tensor | None = None,
        drop_audio: torch.Tensor | None = None,
        drop_affect: torch.Tensor | None = None,
        first_position: torch.Tensor | None = None,
        known: torch.Tensor | None = None,
    ) -> torch.Tensor: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def normalize(self, motion: torch.Tensor) -> torch.Tensor: ...
    def set_motion_statistics(self, mean: torch.Tensor, scale: torch.Tensor) -> None: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> AtsOptions: ...
    @property
    def training(self) -> bool: ...

class GenerateOptions:
    """
    Sampling of motion from speech.
    """

    __hash__: typing.ClassVar[None] = None
    affect_guidance: typing.Any
    articulation: typing.Any
    audio_guidance: typing.Any
    eta: typing.Any
    mouth_temperature: typing.Any
    num_steps: typing.Any
    precision: typing.Any
    sampler: typing.Any
    spacing: typing.Any
    window_overlap: typing.Any
    windows_per_batch: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> GenerateOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: GenerateOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

def articulate(
    motion: torch.Tensor, gain: typing.SupportsFloat | typing.SupportsIndex
) -> torch.Tensor:
    """
    (..., 68, 3) displacements, m, with the motion of lips and jaw scaled about the neutral face; closures stay.
    """

def emotion_track(
    text: str,
    emotions: collections.abc.Sequence[str],
    *,
    intensity: typing.SupportsFloat | typing.SupportsIndex,
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    fps: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """
    Keys such as '0=neutral; 2.5=happy:0.7,surprise:0.3@2.5' to their mixtures (K, E) and intensities (K,), and the weight of each in every frame (T, K).
    """

def generate(
    model: AtsImpl,
    features: torch.Tensor,
    *,
    emotion: torch.Tensor,
    intensity: torch.Tensor,
    weight: torch.Tensor | None = None,
    options: GenerateOptions = ...,
    seeds: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    on_step: collections.abc.Callable[[int, int], None] | None = None,
) -> torch.Tensor: ...
def parse_emotion(text: str, emotions: collections.abc.Sequence[str]) -> torch.Tensor:
    """
    'happy', an alias, or 'happy:0.7,sad:0.3' to a convex mixture (E,).
    """

def window_starts(
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    window: typing.SupportsInt | typing.SupportsIndex,
    overlap: typing.SupportsInt | typing.SupportsIndex,
) -> list[int]: ...
