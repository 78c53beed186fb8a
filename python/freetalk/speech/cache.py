"""Speech features on disk, so that a clip is encoded once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk import _native
from freetalk._native.core import default_cache_dir
from freetalk._native.speech import EncodeOptions
from freetalk.speech.encoder import SpeechEncoder
from freetalk.speech.features import encode_speech

_VERSION = "1"  # of what encode_speech computes


class FeatureCache:
    """:func:`encode_speech` with a memory on disk.

    The key holds the samples, the encoder's options and weights, the frame rate, the options of the encoding and the
    layer weights: what changes the result changes the key. Entries are safetensors files, written atomically; several
    processes may share a folder. A damaged entry is made anew.

    Args:
        encoder: the encoder. Its weights are read once; call :meth:`refresh` after changing them.
        directory: folder of the cache; made if missing. By default ``speech`` in ``$FREETALK_CACHE`` or, where that
            is not set, in ``~/.cache/freetalk``.
        half: store float16, half the size, relative error below 5e-4.
    """

    def __init__(
        self,
        encoder: SpeechEncoder,
        directory: str | os.PathLike[str] | None = None,
        *,
        half: bool = False,
    ) -> None:
        self.encoder = encoder
        self.directory = (
            Path(directory) if directory is not None else default_cache_dir() / "speech"
        )
        self.half = half
        self.refresh()

    def refresh(self) -> None:
        """Reads the encoder's weights again."""
        digest = hashlib.blake2b(repr(self.encoder.options).encode())
        for name, tensor in sorted(self.encoder.state_dict().items()):
            values = tensor.detach().cpu().contiguous()
            digest.update(f"{name} {values.dtype} {tuple(values.shape)}".encode())
            digest.update(values.reshape(-1).view(torch.uint8).numpy())
        self._encoder_key = digest.digest()

    def path(
        self,
        samples: Any,
        fps: float | None,
        options: EncodeOptions | None = None,
        layer_weights: Tensor | None = None,
    ) -> Path:
        """The file that holds, or will hold, these features."""
        wave = np.ascontiguousarray(np.asarray(samples, dtype=np.float32))
        digest = hashlib.blake2b(self._encoder_key, digest_size=16)
        digest.update(f"{_VERSION} {fps!r} {options or EncodeOptions()!r} {self.half}".encode())
        if layer_weights is not None:
            digest.update(layer_weights.detach().cpu().double().numpy().tobytes())
        digest.update(wave.data)
        return self.directory / f"{digest.hexdigest()}.safetensors"

    def encode(
        self,
        samples: Any,
        fps: float | None,
        *,
        options: EncodeOptions | None = None,
        progress: Callable[[float], None] | None = None,
        layer_weights: Tensor | None = None,
    ) -> Tensor:
        """Features as :func:`encode_speech` gives them, (T, C) float32, on the CPU.

        Args:
            samples: (S,) float in [-1, 1], 16 kHz, not normalised.
            fps: of the motion; None for the encoder's own frames.
            options: as in :func:`encode_speech`.
            progress: called with the finished share when the clip has to be encoded.
            layer_weights: as in :func:`encode_speech`.
        """
        path = self.path(samples, fps, options, layer_weights)
        if path.is_file():
            try:
                return _native.core.load_safetensors(str(path))["features"].float()
            except (KeyError, RuntimeError):
                path.unlink(missing_ok=True)
        features = encode_speech(
            self.encoder,
            samples,
            fps,
            options=options,
            progress=progress,
            layer_weights=layer_weights,
        ).cpu()
        stored = features.half() if self.half else features
        _native.core.save_safetensors(str(path), {"features": stored})
        return stored.float()
