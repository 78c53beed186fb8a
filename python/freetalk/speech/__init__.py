"""Speech encoders (HuBERT, wav2vec 2.0) and speech features for every motion frame.

Encoder frame ``i`` is centred at ``i * 320 + 200`` samples of 16 kHz sound; motion frame ``t`` happens
at ``t / fps`` seconds.
"""

from __future__ import annotations

from freetalk._native.speech import (
    SAMPLE_RATE_HZ,
    EncodeOptions,
    FrameTiming,
    SpeechEncoderOptions,
    hubert_base,
    hubert_large,
    hubert_tiny,
    hubert_xlarge,
    num_motion_frames,
    stream_options,
    wav2vec2_base,
    wav2vec2_large,
    wav2vec2_large_lv60,
)
from freetalk.speech.adapter import FeatureAdapter
from freetalk.speech.checkpoint import convert_checkpoint
from freetalk.speech.encoder import SpeechEncoder
from freetalk.speech.features import (
    SpeechStream,
    encode_speech,
    normalize_wave,
    resample_features,
)

__all__ = [
    "SAMPLE_RATE_HZ",
    "EncodeOptions",
    "FeatureAdapter",
    "FrameTiming",
    "SpeechEncoder",
    "SpeechEncoderOptions",
    "SpeechStream",
    "convert_checkpoint",
    "encode_speech",
    "hubert_base",
    "hubert_large",
    "hubert_tiny",
    "hubert_xlarge",
    "normalize_wave",
    "num_motion_frames",
    "resample_features",
    "stream_options",
    "wav2vec2_base",
    "wav2vec2_large",
    "wav2vec2_large_lv60",
]
