"""FaceTalk's weights opened for evaluation: what is heard in, codes and the landmarks that they move out."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from freetalk.ats import articulate
from freetalk.data import Dataset, MotionSequence
from freetalk.evaluate.pretrained import FloatArray, at_rate, device_of
from freetalk.facetalk import FaceTalk, GenerateOptions, generate
from freetalk.speech import EncodeOptions, SpeechEncoder, encode_speech

#: Of folders that do not say.
USUAL_SAMPLING: dict[str, object] = {"sampler": "dpmpp", "num_steps": 20}


class SpeechToCodes:
    """Speech encoder and FaceTalk on one device.

    Args:
        encoder: folder of the speech encoder; not read where the weights hear landmarks.
        weights: folder that ``freetalk train facetalk`` wrote.
        sampling: fields of ``facetalk.GenerateOptions``.
        device: where it runs, see :func:`device_of`.
        articulation: gain of the mouth's motion, see :func:`freetalk.ats.articulate`.
    """

    def __init__(
        self,
        encoder: Path,
        weights: Path,
        sampling: Mapping[str, object],
        device: torch.device | str | None = None,
        articulation: float = 1.0,
    ) -> None:
        self.device = device_of(device)
        self.articulation = articulation
        self.model = FaceTalk.from_pretrained(weights).to(self.device).eval()
        self.options = GenerateOptions.from_dict(dict(sampling))
        self.fps = float(self.model.options.fps)
        self._encoder: SpeechEncoder | None = None
        if self.model.options.condition == "audio":
            self._encoder = SpeechEncoder.from_pretrained(encoder).to(self.device).eval()

    @classmethod
    def of(
        cls,
        directory: str | Path,
        sampling: Mapping[str, object] | None = None,
        device: torch.device | str | None = None,
    ) -> SpeechToCodes:
        """Of a folder with ``speech`` and ``facetalk``, sampled as a talker does.

        Args:
            directory: the folder; its ``talker.json`` says how, and at which articulation.
            sampling: fields of ``facetalk.GenerateOptions`` that win over a talker's.
            device: see :func:`device_of`.
        """
        path = Path(directory)
        about = path / "talker.json"
        own = json.loads(about.read_text()) if about.is_file() else {}
        chosen = {**USUAL_SAMPLING, **own.get("facetalk", {}), **(sampling or {})}
        gain = float(chosen.pop("articulation", 1.0))
        return cls(path / "speech", path / "facetalk", chosen, device, gain)

    def heard(self, dataset: Dataset, clip: MotionSequence) -> torch.Tensor:
        """Speech features or landmarks at the model's frames, (T, C), on the device."""
        if self._encoder is None:
            own = dataset.select([clip]).at(self.fps)
            landmarks = own.landmarks(own.sequences()[0])
            return torch.from_numpy(landmarks).flatten(1).to(self.device)
        wave = torch.from_numpy(np.array(dataset.audio(clip)))
        options = EncodeOptions(resample=self.model.options.feature_resampling)
        return encode_speech(self._encoder, wave, self.fps, options=options)

    def codes(self, heard: torch.Tensor, seeds: Sequence[int]) -> torch.Tensor:
        """Codes (K, T, Z) of a motion for each seed."""
        return generate(self.model, heard, options=self.options, seed=list(seeds))

    def perform(
        self,
        dataset: Dataset,
        clips: Sequence[MotionSequence],
        seeds: Sequence[Sequence[int]],
    ) -> Iterator[tuple[MotionSequence, FloatArray]]:
        """Landmark motion of clips.

        Args:
            dataset: whose clips they are.
            clips: with sound.
            seeds: K a clip, of as many performances.

        Yields:
            Clip and displacements (K, T, 68, 3) m, at the clip's frame rate.
        """
        for clip, own in zip(clips, seeds, strict=True):
            codes = self.codes(self.heard(dataset, clip), own)
            motions = articulate(self.model.landmarks(codes), self.articulation).cpu()
            yield clip, np.stack([at_rate(one, self.fps, clip) for one in motions.numpy()])
