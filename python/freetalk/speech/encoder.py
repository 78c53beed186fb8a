"""The speech encoder as a ``torch.nn.Module``."""

from __future__ import annotations

import json
import os
from typing import Any

from torch import Tensor, nn

from freetalk import _native
from freetalk._module import NativeModule
from freetalk._native.speech import FrameTiming, SpeechEncoderOptions


class SpeechEncoder(NativeModule):
    """HuBERT or wav2vec 2.0 encoder: 16 kHz speech in, features at 50 Hz out.

    Parameter names are those of ``HubertModel`` and ``Wav2Vec2Model`` in ``transformers``. Without gradients, in
    evaluation mode and on a CPU, float32 and bfloat16 (``encoder.bfloat16()`` or autocast) take a faster way to the
    same result.

    Args:
        options: a :class:`SpeechEncoderOptions`, e.g. ``hubert_tiny()``; HuBERT base if left out.
        fields: options by name, over ``options``.
    """

    _impl_type = _native.speech.SpeechEncoderImpl
    _options_type = SpeechEncoderOptions
    _format = "freetalk-speech"

    def forward(self, wave: Tensor, mask: Tensor | None = None, *, layer: int = -1) -> Tensor:
        """A hidden state, by default the last.

        Args:
            wave: (B, S) float, 16 kHz, see :func:`normalize_wave`.
            mask: (B, S) bool or integer, nonzero where samples are real: ones, then padding.
            layer: 0 is what the first layer gets, i what layer i gives, -1 the last; later layers are not computed.

        Returns:
            (B, S', C), S' = ``num_frames(S)``; padded frames hold nothing of meaning.

        Raises:
            ValueError: shapes disagree, or a clip is shorter than ``receptive_field``.
        """
        return self._impl.forward(wave, mask, layer)

    def hidden_states(self, wave: Tensor, mask: Tensor | None = None) -> list[Tensor]:
        """All ``num_hidden_layers + 1`` hidden states, (B, S', C) each, first that which the first layer gets."""
        return self._impl.hidden_states(wave, mask)

    def extract_features(self, wave: Tensor, mask: Tensor | None = None) -> Tensor:
        """First half of :meth:`forward`: (B, S) to (B, S', C_conv), the output of the convolutions."""
        return self._impl.extract_features(wave, mask)

    def encode_features(
        self, features: Tensor, valid_frames: Tensor | None = None, *, layer: int = -1
    ) -> Tensor:
        """Second half of :meth:`forward`: projection and transformer, at any frame rate.

        Args:
            features: (B, S', C_conv).
            valid_frames: (B,) int64 number of real frames, or None when all are.
            layer: hidden state to return, as in :meth:`forward`.

        Returns:
            (B, S', C).
        """
        return self._impl.encode_features(features, valid_frames, layer)

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
            self._plain_impl, os.fspath(directory), half=half, extra_json=json.dumps(extra)
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
        module._bind(_native.speech.load_speech_encoder(os.fspath(directory)))
        return module.eval()
