from __future__ import annotations
import collections.abc
import os
import torch
import typing

__all__: list[str] = [
    "EncodeOptions",
    "FrameTiming",
    "SAMPLE_RATE_HZ",
    "SpeechEncoderImpl",
    "SpeechEncoderOptions",
    "SpeechStream",
    "encode_speech",
    "hubert_base",
    "hubert_large",
    "hubert_tiny",
    "hubert_xlarge",
    "load_speech_encoder",
    "motion_features",
    "normalize_wave",
    "num_motion_frames",
    "resample_features",
    "save_speech_encoder",
    "stream_options",
    "wav2vec2_base",
    "wav2vec2_large",
    "wav2vec2_large_lv60",
]

class SpeechEncoderOptions:
    """
    Options of a HuBERT or wav2vec 2.0 encoder, named as in Hugging Face's config.json.
    """

    __hash__: typing.ClassVar[None] = None
    activation_dropout: typing.Any
    attention_dropout: typing.Any
    conv_bias: typing.Any
    conv_dim: typing.Any
    conv_kernel: typing.Any
    conv_stride: typing.Any
    do_stable_layer_norm: typing.Any
    feat_extract_activation: typing.Any
    feat_extract_norm: typing.Any
    feat_proj_dropout: typing.Any
    feat_proj_layer_norm: typing.Any
    hidden_act: typing.Any
    hidden_dropout: typing.Any
    hidden_size: typing.Any
    initializer_range: typing.Any
    intermediate_size: typing.Any
    layer_norm_eps: typing.Any
    layerdrop: typing.Any
    mask_group_norm: typing.Any
    model_type: typing.Any
    num_attention_heads: typing.Any
    num_conv_pos_embedding_groups: typing.Any
    num_conv_pos_embeddings: typing.Any
    num_hidden_layers: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SpeechEncoderOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SpeechEncoderOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class EncodeOptions:
    """
    How encode_speech and SpeechStream work through speech of any length.
    """

    __hash__: typing.ClassVar[None] = None
    context_s: typing.Any
    fade_s: typing.Any
    layer: typing.Any
    lookahead_s: typing.Any
    precision: typing.Any
    resample: typing.Any
    streamable: typing.Any
    window_s: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> EncodeOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: EncodeOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class FrameTiming:
    """
    When frames happen: frame i is centred at offset_s + i / rate_hz.
    """
    def __init__(
        self,
        rate_hz: typing.SupportsFloat | typing.SupportsIndex = 50.0,
        offset_s: typing.SupportsFloat | typing.SupportsIndex = 0.0125,
    ) -> None: ...
    @property
    def offset_s(self) -> float: ...
    @property
    def rate_hz(self) -> float: ...

class SpeechEncoderImpl:
    def __init__(self, options: SpeechEncoderOptions) -> None: ...
    def encode_features(
        self,
        features: torch.Tensor,
        valid_frames: torch.Tensor | None = None,
        layer: typing.SupportsInt | typing.SupportsIndex = -1,
    ) -> torch.Tensor: ...
    def encode_states(
        self, features: torch.Tensor, valid_frames: torch.Tensor | None = None
    ) -> list[torch.Tensor]: ...
    def extract_features(
        self, wave: torch.Tensor, mask: torch.Tensor | None = None
    ) -> torch.Tensor: ...
    def forward(
        self,
        wave: torch.Tensor,
        mask: torch.Tensor | None = None,
        layer: typing.SupportsInt | typing.SupportsIndex = -1,
    ) -> torch.Tensor: ...
    def hidden_states(
        self, wave: torch.Tensor, mask: torch.Tensor | None = None
    ) -> list[torch.Tensor]: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def num_frames(self, num_samples: typing.SupportsInt | typing.SupportsIndex) -> int: ...
    def train(self, mode: bool) -> None: ...
    @property
    def frame_stride(self) -> int: ...
    @property
    def options(self) -> SpeechEncoderOptions: ...
    @property
    def receptive_field(self) -> int: ...
    @property
    def timing(self) -> FrameTiming: ...
    @property
    def training(self) -> bool: ...

class SpeechStream:
    """
    Speech features while the speech is being recorded.
    """
    def __init__(
        self,
        encoder: SpeechEncoderImpl,
        fps: typing.SupportsFloat | typing.SupportsIndex | None,
        *,
        options: EncodeOptions,
        layer_weights: torch.Tensor | None = None,
    ) -> None: ...
    def finish(self) -> torch.Tensor: ...
    def push(self, samples: torch.Tensor) -> torch.Tensor: ...
    @property
    def latency_s(self) -> float: ...

def encode_speech(
    encoder: SpeechEncoderImpl,
    samples: torch.Tensor,
    fps: typing.SupportsFloat | typing.SupportsIndex | None,
    *,
    options: EncodeOptions,
    progress: collections.abc.Callable[[float], None] | None = None,
    layer_weights: torch.Tensor | None = None,
) -> torch.Tensor: ...
def hubert_base() -> SpeechEncoderOptions:
    """
    Options of facebook/hubert-base-ls960.
    """

def hubert_large() -> SpeechEncoderOptions:
    """
    Options of facebook/hubert-large-ll60k.
    """

def hubert_tiny() -> SpeechEncoderOptions:
    """
    Options of a small HuBERT for two CPU cores.
    """

def hubert_xlarge() -> SpeechEncoderOptions:
    """
    Options of facebook/hubert-xlarge-ll60k.
    """

def load_speech_encoder(dir: os.PathLike | str | bytes) -> SpeechEncoderImpl: ...
def motion_features(
    encoder: SpeechEncoderImpl,
    wave: torch.Tensor,
    mask: torch.Tensor | None,
    *,
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    options: EncodeOptions,
    layer_weights: torch.Tensor | None = None,
) -> torch.Tensor: ...
def normalize_wave(wave: torch.Tensor, mask: torch.Tensor | None = None) -> torch.Tensor: ...
def num_motion_frames(
    num_samples: typing.SupportsInt | typing.SupportsIndex,
    fps: typing.SupportsFloat | typing.SupportsIndex,
) -> int: ...
@typing.overload
def resample_features(
    features: torch.Tensor, num_frames: typing.SupportsInt | typing.SupportsIndex
) -> torch.Tensor: ...
@typing.overload
def resample_features(
    features: torch.Tensor,
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    fps: typing.SupportsFloat | typing.SupportsIndex,
    timing: FrameTiming,
    valid_frames: torch.Tensor | None = None,
) -> torch.Tensor: ...
def save_speech_encoder(
    encoder: SpeechEncoderImpl,
    dir: os.PathLike | str | bytes,
    *,
    half: bool = False,
    extra_json: str = "{}",
) -> None: ...
def stream_options() -> EncodeOptions:
    """
    EncodeOptions for a stream.
    """

def wav2vec2_base() -> SpeechEncoderOptions:
    """
    Options of facebook/wav2vec2-base.
    """

def wav2vec2_large() -> SpeechEncoderOptions:
    """
    Options of facebook/wav2vec2-large.
    """

def wav2vec2_large_lv60() -> SpeechEncoderOptions:
    """
    Options of facebook/wav2vec2-large-lv60 and facebook/wav2vec2-large-xlsr-53.
    """

SAMPLE_RATE_HZ: int = 16000
