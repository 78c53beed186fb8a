"""Speech features inside a model that is trained: which layer, at which rate, with which parts frozen."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from freetalk import _native
from freetalk._native.speech import EncodeOptions
from freetalk.speech.encoder import SpeechEncoder
from freetalk.speech.features import encode_speech

TRAINED = ("none", "transformer", "all")


class FeatureAdapter(nn.Module):
    """An encoder and the way from its hidden states to one feature vector per motion frame.

    Args:
        encoder: HuBERT or wav2vec 2.0; a part of this module.
        fps: rate of the motion, frame t happens at ``t / fps`` seconds.
        layer: hidden state to take (-1 the last, 0 what the first layer gets), or ``"weighted"``: a learned sum of all
            of them, with weights ``softmax(layer_logits)`` that start equal.
        resample: ``"output"`` of the transformer (FreeTalk), or ``"conv"``: features of the convolutions, before the
            transformer (ScanTalk, FaceTalk).
        train: ``"none"`` of the encoder is trained, only its ``"transformer"`` (convolutions frozen, as HuBERT and
            wav2vec 2.0 are fine-tuned), or ``"all"``. Frozen parts get no gradients; an encoder frozen whole stays
            in evaluation mode.

    Raises:
        ValueError: a value is none of those above, or ``layer`` beyond the encoder's layers.
    """

    def __init__(
        self,
        encoder: SpeechEncoder,
        fps: float,
        *,
        layer: int | str = -1,
        resample: str = "output",
        train: str = "none",
    ) -> None:
        super().__init__()
        if train not in TRAINED:
            raise ValueError(f"train is '{train}': use one of {', '.join(TRAINED)}")
        num_layers = encoder.options.num_hidden_layers
        if layer != "weighted" and not (isinstance(layer, int) and -1 <= layer <= num_layers):
            raise ValueError(f"layer is {layer!r}: use -1 to {num_layers}, or 'weighted'")
        if not fps > 0:
            raise ValueError(f"fps is {fps}: it must be positive")
        self.encoder = encoder
        self.fps = float(fps)
        self.trained = train
        self.encode_options = EncodeOptions(
            layer=layer if isinstance(layer, int) else -1, resample=resample
        )
        self.layer_logits = (
            nn.Parameter(torch.zeros(num_layers + 1)) if layer == "weighted" else None
        )
        for name, parameter in encoder.named_parameters():
            frozen = train == "none" or (
                train == "transformer" and name.startswith("feature_extractor.")
            )
            parameter.requires_grad_(not frozen)
        self.train(self.training)

    @property
    def layer_weights(self) -> Tensor | None:
        """Weights of the hidden states, (num_hidden_layers + 1,), or None when one layer is taken."""
        return None if self.layer_logits is None else self.layer_logits.softmax(0)

    @property
    def width(self) -> int:
        """C, the width of a feature vector."""
        return int(self.encoder.options.hidden_size)

    def train(self, mode: bool = True) -> FeatureAdapter:
        """Sets training mode; an encoder that is frozen whole stays in evaluation mode."""
        super().train(mode)
        if self.trained == "none":
            self.encoder.eval()
        return self

    def forward(self, wave: Tensor, num_frames: int, mask: Tensor | None = None) -> Tensor:
        """Features of a batch in one pass, with gradients as ``train`` says.

        Args:
            wave: (B, S) float, 16 kHz, see :func:`freetalk.speech.normalize_wave`.
            num_frames: T, motion frames of the result.
            mask: (B, S) bool or integer, nonzero where samples are real: ones, then padding.

        Returns:
            (B, T, C); frames after the end of a clip hold nothing of meaning.
        """
        return _native.speech.motion_features(
            self.encoder._plain_impl,
            wave,
            mask,
            num_frames=num_frames,
            fps=self.fps,
            options=self.encode_options,
            layer_weights=self.layer_weights,
        )

    @torch.no_grad()
    def encode(self, samples: Any, options: EncodeOptions | None = None) -> Tensor:
        """Features of a clip of any length, without gradients.

        Args:
            samples: (S,) float in [-1, 1], 16 kHz, not normalised.
            options: pieces and precision; layer and place of the resampling are those of this adapter.

        Returns:
            (T, C) float32, T = ``num_motion_frames(S, fps)``.
        """
        own = self.encode_options.to_dict()
        chosen = options.to_dict() if options is not None else own
        merged = {**chosen, "layer": own["layer"], "resample": own["resample"]}
        return encode_speech(
            self.encoder,
            samples,
            self.fps,
            options=EncodeOptions.from_dict(merged),
            layer_weights=self.layer_weights,
        )
