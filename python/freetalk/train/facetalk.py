"""Training of FaceTalk's denoiser: speech to expression weights, or to codes of a parametric head [FaceTalk Sec. 4]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.ats import MOTION_DIM
from freetalk.data import NUM_LANDMARKS, Dataset, DatasetError, MotionSequence
from freetalk.data.pack import FloatArray
from freetalk.facetalk import FaceTalk, FaceTalkOptions, GenerateOptions, generate
from freetalk.train.config import TrainingConfig
from freetalk.train.denoising import (
    VALIDATION_SEED,
    DenoisingTask,
    lip_gaps,
    mean_and_spread,
    opening,
    usual_opening,
)
from freetalk.train.losses import motion_loss
from freetalk.train.task_options import FaceTalkTaskOptions
from freetalk.train.windows import CodeWindows

#: Takes and frames of each that statistics and the map to the landmarks are computed of.
_TAKES, _FRAMES = 600, 100


class FaceTalkTask(DenoisingTask):
    """Windows of codes with their speech features; the denoiser restores them from noise."""

    options: FaceTalkTaskOptions
    model: FaceTalk
    model_options: FaceTalkOptions
    sample_frames = 72
    full_precision = ("code_", "rest_", "landmark_")

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, FaceTalkTaskOptions)
        self.options = config.task
        usual = FaceTalkOptions()
        given = {"fps": usual.fps, **config.model}
        hears = str(given.get("condition", "audio")) == "audio"
        super().__init__(config, corpus, out, device, given, hears)
        own, rest = _codes_of(self.corpus, self.options.targets)
        resampling = str(given.get("feature_resampling", usual.feature_resampling))
        features = self._speech_features(resampling) if hears else None
        fields = {"audio_dim": features.width if features else MOTION_DIM, **own, **given}
        self.model_options = FaceTalkOptions.from_dict(fields)
        self.windows = CodeWindows(self.options, self.corpus, features, rest)
        self._begin(config.loop, FaceTalk, self.options.window_frames)
        self._statistics = self._measure(rest)
        on_device = {name: value.to(device) for name, value in self._statistics.items()}
        self.model.set_code_statistics(**on_device)

    def _drawn(self, rng: np.random.Generator, frames: int) -> dict[str, Any]:
        step = self._diffusion_step(rng)
        return {"step": step, "drop_audio": rng.random() < self.options.audio_dropout}

    def _opening(self, motion: Tensor) -> Tensor:
        own = self._statistics  # on the host, as the batch
        moved = (motion - own["rest"]) @ own["landmark_basis"]
        return opening(moved.unflatten(-1, (NUM_LANDMARKS, 3)))

    def _speaking(self) -> list[MotionSequence]:
        return super()._speaking() or self.held_out

    def _spoken(
        self, clip: MotionSequence, frames: int, drawn: dict[str, Any], seed: int
    ) -> Tensor:
        options = GenerateOptions(**drawn)
        codes = generate(self.model, self._heard(clip, frames), options=options, seed=seed)
        return self.model.landmarks(codes)

    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        o, valid = self.options, batch["valid"]
        target = self.model.normalize(batch["codes"]) * valid[..., None]
        guess = self._estimate(batch, step, self.schedule.q_sample(target, step, noise=noise))
        codes = self.model.denormalize(guess)
        given, wanted = (codes, batch["codes"]) if o.loss_units == "codes" else (guess, target)
        # Each code counts as a point, so that the norm is averaged over all of them.
        terms = motion_loss(
            given[..., None],
            wanted[..., None],
            valid,
            o.lambda_velocity,
            counts=batch.get("counts"),
        )
        del terms["acceleration"]
        moved, true = (self.model.landmarks(one) for one in (codes, batch["codes"]))
        gap, true_gap = (lip_gaps(one) / self.usual_opening for one in (moved, true))
        return self._with_lips(terms, batch, (gap, true_gap), (opening(moved), opening(true)))

    def _estimate(self, batch: dict[str, Any], step: Tensor, noisy: Tensor) -> Tensor:
        guess: Tensor = self.model(
            noisy,
            step,
            audio=batch["audio"],
            drop_audio=batch.get("drop_audio"),
            valid=None if self.model_options.align_audio else batch["valid"],
        )
        return guess.float()

    def _measure(self, rest: FloatArray) -> dict[str, Tensor]:
        """Mean and spread of each code over what the sampler draws, and what codes do to the landmarks."""
        rng = np.random.default_rng(VALIDATION_SEED)
        codes, landmarks = [], []
        for _ in range(_TAKES):
            sequence = self.sampler.draw(rng)
            own = self.windows.motion(sequence, 0, None)
            at = rng.integers(0, len(own), _FRAMES)
            codes.append(own[at])
            landmarks.append(self.corpus.landmarks(sequence)[at].reshape(_FRAMES, -1))
        drawn, points = np.concatenate(codes), np.concatenate(landmarks)
        if not np.isfinite(drawn).all():
            raise DatasetError(f"{self.corpus.name} has codes that are not finite")
        self.usual_opening = usual_opening(points.reshape(-1, NUM_LANDMARKS, 3))
        mean, scale = mean_and_spread(drawn)
        basis = torch.from_numpy(_linear_map(drawn - rest, points))
        neutral = torch.from_numpy(rest).float()
        return {"mean": mean, "scale": scale, "rest": neutral, "landmark_basis": basis}


def _codes_of(corpus: Dataset, targets: str) -> tuple[dict[str, Any], FloatArray]:
    """The model options that follow from the codes, and the code of the face at rest.

    Raises:
        DatasetError: the data has no such codes.
    """
    if targets == "head":
        about = corpus.head_codes()
        return {"codes": "head", "head": about.head, "code_dim": len(about.rest)}, about.rest
    names = corpus.expressions
    if not names:
        raise DatasetError(
            f"{corpus.name} has no expression weights that all of its faces share: task.targets=weights needs the "
            "open corpus, or data fitted like it"
        )
    own = {"codes": "weights", "expressions": list(names), "code_dim": len(names)}
    return own, np.zeros(len(names), np.float32)


def _linear_map(codes: FloatArray, points: FloatArray) -> FloatArray:
    """(Z, 204) least squares map from codes (N, Z) to points (N, 204); codes that hardly vary do nothing."""
    square = codes.T.astype(np.float64) @ codes
    ridge = 1e-6 * np.trace(square) / len(square)
    found = np.linalg.solve(square + ridge * np.eye(len(square)), codes.T @ points)
    return found.astype(np.float32)
