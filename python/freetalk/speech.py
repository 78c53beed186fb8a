"""Speech encoders (HuBERT, wav2vec 2.0) and speech features for every motion frame.

Encoder frame ``i`` is centred at ``i * 320 + 200`` samples of 16 kHz sound; motion frame ``t`` happens
at ``t / fps`` seconds.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import Any, cast

import torch
from torch import Tensor, nn

from freetalk import _native
from freetalk._module import NativeModule
from freetalk._native.speech import (
    SAMPLE_RATE_HZ,
    EncodeOptions,
    FrameTiming,
    SpeechEncoderOptions,
    hubert_base,
    hubert_large,
    hubert_tiny,
    num_motion_frames,
    wav2vec2_base,
)

__all__ = [
    "SAMPLE_RATE_HZ",
    "EncodeOptions",
    "FrameTiming",
    "SpeechEncoder",
    "SpeechEncoderOptions",
    "encode_speech",
    "hubert_base",
    "hubert_large",
    "hubert_tiny",
    "normalize_wave",
    "num_motion_frames",
    "resample_features",
    "wav2vec2_base",
]


class SpeechEncoder(NativeModule):
    """HuBERT or wav2vec 2.0 encoder: 16 kHz speech in, features at 50 Hz out.

    Parameter names are those of ``HubertModel`` and ``Wav2Vec2Model`` in ``transformers``.

    Args:
        options: a :class:`SpeechEncoderOptions`, e.g. ``hubert_tiny()``; HuBERT base if left out.
        fields: options by name, over ``options``.
    """

    _impl_type = _native.speech.SpeechEncoderImpl
    _options_type = SpeechEncoderOptions
    _format = "freetalk-speech"

    def forward(self, wave: Tensor, mask: Tensor | None = None) -> Tensor:
        """Last hidden state.

        Args:
            wave: (B, S) float, 16 kHz, see :func:`normalize_wave`.
            mask: (B, S) bool or integer, nonzero where samples are real: ones, then padding.

        Returns:
            (B, S', C), S' = ``num_frames(S)``; padded frames hold nothing of meaning.

        Raises:
            ValueError: shapes disagree, or a clip is shorter than ``receptive_field``.
        """
        return self._impl.forward(wave, mask)

    def extract_features(self, wave: Tensor, mask: Tensor | None = None) -> Tensor:
        """First half of :meth:`forward`: (B, S) to (B, S', C_conv), the output of the convolutions."""
        return self._impl.extract_features(wave, mask)

    def encode_features(self, features: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Second half of :meth:`forward`: projection and transformer, at any frame rate.

        Args:
            features: (B, S', C_conv).
            valid_frames: (B,) int64 number of real frames, or None when all are.

        Returns:
            (B, S', C).
        """
        return self._impl.encode_features(features, valid_frames)

    def num_frames(self, num_samples: int) -> int:
        """Frames of a clip: ``(num_samples - 400) // 320 + 1`` for the standard extractor."""
        return self._impl.num_frames(num_samples)

    @property
    def receptive_field(self) -> int:
        """Samples that one frame sees."""
        return self._impl.receptive_field

    @property
    def frame_stride(self) -> int:
        """Samples between frames."""
        return self._impl.frame_stride

    @property
    def timing(self) -> FrameTiming:
        """When frames happen."""
        return self._impl.timing

    def save_pretrained(
        self, directory: str | os.PathLike[str], *, half: bool = False, **extra: Any
    ) -> None:
        """Writes a folder that :meth:`from_pretrained` and ``transformers`` read.

        Args:
            directory: folder to write to; made if missing.
            half: store float16.
            extra: further JSON values for config.json, such as ``training={...}``.
        """
        _native.speech.save_speech_encoder(
            self._impl, os.fspath(directory), half=half, extra_json=json.dumps(extra)
        )

    @classmethod
    def from_pretrained(cls, directory: str | os.PathLike[str]) -> SpeechEncoder:
        """Loads a Hugging Face folder: config.json and model.safetensors (or its shards).

        Raises:
            RuntimeError: a file is missing or broken, the architecture is another one, or tensors do not fit; the
                message names each.
        """
        module = cls.__new__(cls)
        nn.Module.__init__(module)
        object.__setattr__(
            module, "_impl", _native.speech.load_speech_encoder(os.fspath(directory))
        )
        module._adopt()
        return module.eval()


def normalize_wave(wave: Tensor, mask: Tensor | None = None) -> Tensor:
    """Zero mean and unit variance over each clip, ``(x - mean) / sqrt(variance + 1e-7)``.

    Args:
        wave: (S,) or (B, S) float.
        mask: same shape, nonzero where samples are real; padding becomes 0.
    """
    return _native.speech.normalize_wave(wave, mask)


def resample_features(
    features: Tensor,
    num_frames: int,
    fps: float | None = None,
    timing: FrameTiming | None = None,
) -> Tensor:
    """Features of motion frames by linear interpolation in time; ends are held.

    Args:
        features: (B, S', C) or (S', C) float.
        num_frames: T, frames of the result.
        fps: of the motion: frame t is at ``t / fps`` seconds. None spreads the frames evenly over the clip, whose
            length is then known to 10 ms only.
        timing: of the encoder's frames, if not the standard 50 Hz.

    Returns:
        (B, T, C) or (T, C).
    """
    if fps is None:
        if timing is not None:
            raise ValueError("timing needs fps")
        return _native.speech.resample_features(features, num_frames)
    return _native.speech.resample_features(features, num_frames, fps, timing or FrameTiming())


def encode_speech(
    encoder: SpeechEncoder,
    samples: Any,
    fps: float,
    *,
    options: EncodeOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Tensor:
    """Speech features for every motion frame of a clip of any length, without gradients.

    Clips longer than ``options.window_s`` are encoded in overlapping windows that are cross-faded, so that
    memory grows only with the result. With a group norm extractor (HuBERT base, tiny) the norm's statistics
    belong to each window.

    Args:
        encoder: the encoder, left as it was.
        samples: (S,) float tensor or array in [-1, 1], 16 kHz, not normalised.
        fps: of the motion, > 0.
        options: window and context.
        progress: called with the finished share in (0, 1].

    Returns:
        (T, C) on the encoder's device, T = ``max(1, round(S / 16000 * fps))``.
    """
    wave = samples if isinstance(samples, Tensor) else torch.tensor(samples)
    return _native.speech.encode_speech(
        encoder._impl,
        wave,
        fps,
        options=options or EncodeOptions(),
        progress=cast("Any", progress),
    )
