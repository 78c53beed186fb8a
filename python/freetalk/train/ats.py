"""Training of the audio-to-landmarks denoiser [FreeTalk 3.1, 3.3, supp. 2]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.ats import Ats, AtsOptions, GenerateOptions, generate
from freetalk.data import NUM_LANDMARKS, Dataset, MotionSequence
from freetalk.data.landmarks import UPPER_FACE
from freetalk.train.config import TrainingConfig
from freetalk.train.denoising import (
    VALIDATION_SEED,
    DenoisingTask,
    lip_gaps,
    mean_and_spread,
    opening,
    usual_opening,
)
from freetalk.train.losses import MILLIMETRES, landmark_weights, motion_loss
from freetalk.train.task_options import AtsTaskOptions
from freetalk.train.windows import AtsWindows

# Frames of a window that goes on from known ones: those to be found, and those known.
_FEWEST_FRESH, _MOST_FRESH, _MOST_KNOWN = 3, 24, 60


class AtsTask(DenoisingTask):
    """Windows of motion with their speech features; the denoiser restores them from noise."""

    options: AtsTaskOptions
    model: Ats
    model_options: AtsOptions
    sample_frames = 90
    full_precision = ("motion_",)

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, AtsTaskOptions)
        self.options = config.task
        super().__init__(config, corpus, out, device, config.model)
        self.features = self._speech_features()
        fields = {"audio_dim": self.features.width, **config.model, "fps": self.corpus.fps}
        if fields["audio_dim"] != self.features.width:
            raise ValueError(
                f"model.audio_dim is {fields['audio_dim']}, but the encoder in {self._encoder['folder']} gives "
                f"{self.features.width} channels; leave model.audio_dim out"
            )
        self.model_options = AtsOptions.from_dict(fields)
        frames = self.model_options.max_frames
        self.windows = windows = AtsWindows(
            self.options, self.corpus, self.features, self.sampler.sequences, self._shares, frames
        )
        self.model_options.trained_frames = windows.longest()
        self.model_options.known_prefix = self.options.known_prefix > 0
        self._begin(config.loop, Ats, frames)
        self.model.set_motion_statistics(*self._statistics())
        self.point_weights = landmark_weights(
            self.options.lip_weight, self.options.eye_weight, device
        )
        coordinates = torch.ones(NUM_LANDMARKS, 3, dtype=torch.bool, device=device)
        coordinates[list(UPPER_FACE)] = False
        self.mouth = coordinates.flatten()  # (204,) mouth, nose and jaw

    @property
    def mean(self) -> Tensor:
        """(204,) mean of the motion, m; the model's, which may come with its weights."""
        return self.model.get_buffer("motion_mean")

    @property
    def spread(self) -> Tensor:
        """(204,) standard deviation of the motion, m, likewise."""
        return self.model.get_buffer("motion_scale")

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """As of any denoiser; some are cut off a few frames after the ``known`` ones."""
        window = super().item(rng, number)
        frames = len(window["motion"])
        if rng.random() >= self.options.known_prefix:
            return {**window, "known": 0}
        fresh = int(rng.integers(min(frames, _FEWEST_FRESH), min(frames, _MOST_FRESH) + 1))
        known = int(rng.integers(min(frames - fresh, _MOST_KNOWN) + 1))
        cut = {name: window[name][: known + fresh] for name in ("audio", "motion", "noise")}
        return {**window, **cut, "known": known}

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """As of any denoiser; ``rehearsed`` are the rows that are."""
        batch = super().collate(items)
        return {**batch, "rehearsed": batch["rehearsed"].nonzero()[:, 0]}

    def _drawn(self, rng: np.random.Generator, frames: int) -> dict[str, Any]:
        o, spare = self.options, self.model_options.max_frames - frames
        return {
            "first_position": int(rng.integers(spare + 1)) if o.position_offsets else 0,
            "drop_audio": rng.random() < o.audio_dropout,
            "drop_affect": rng.random() < o.affect_dropout,
            "rehearsed": rng.random() < o.rehearsal,
            "step": self._diffusion_step(rng),
        }

    def _opening(self, motion: Tensor) -> Tensor:
        return opening(motion.unflatten(-1, (NUM_LANDMARKS, 3)))

    def _denoised(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Losses at fixed diffusion steps, and the opening that is guessed from noise."""
        guess = self._denoise(batch, self._step_at(1.0, batch), batch["noise"])
        openings = [self._opening(guess * self.spread + self.mean), self._opening(batch["motion"])]
        return {
            **super()._denoised(batch),
            "openings": [one[batch["valid"]].cpu().numpy() for one in openings],
        }

    def _spoken(
        self, clip: MotionSequence, frames: int, drawn: dict[str, Any], seed: int
    ) -> Tensor:
        emotion = torch.zeros(len(self.corpus.emotions))
        emotion[clip.emotion] = 1.0
        return generate(
            self.model,
            self._heard(clip, frames),
            emotion=emotion.to(self.device),
            intensity=float(clip.intensity),
            options=GenerateOptions(**drawn),
            seed=seed,
        )

    def _described(self) -> dict[str, Any]:
        return {"emotions": list(self.corpus.emotions)}

    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        o = self.options
        target = self._normalised(batch)
        found = self._denoise(batch, step, noise)
        guess = torch.where(self._known(batch), target, found)
        openings = self._opening(guess * self.spread + self.mean), self._opening(batch["motion"])
        if o.loss_units == "millimetres":
            unit = MILLIMETRES * self.spread
            guess, target = guess * unit, target * unit  # the mean cancels
        shape = (*guess.shape[:-1], NUM_LANDMARKS, 3)
        guess, target = guess.view(shape), target.view(shape)
        terms = motion_loss(
            guess,
            target,
            batch["valid"],
            o.lambda_velocity,
            o.lambda_acceleration,
            self.point_weights,
            batch.get("counts"),
        )
        return self._with_lips(terms, batch, (lip_gaps(guess), lip_gaps(target)), openings)

    def _denoise(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> Tensor:
        clean = self._normalised(batch)
        rows: Tensor | None = batch.get("rehearsed")
        if rows is not None and len(rows):
            whole = ("counts", "rehearsed", "known")
            some = {name: value[rows] for name, value in batch.items() if name not in whole}
            with torch.no_grad():
                last = torch.full_like(step[rows], self.model_options.num_train_steps - 1)
                own = self._estimate(some, last, noise[rows]) * some["valid"][..., None]
            clean[rows] = torch.where(self.mouth, own, clean[rows])
        noisy = self.schedule.q_sample(clean, step, noise=noise)
        return self._estimate(batch, step, torch.where(self._known(batch), clean, noisy))

    def _known(self, batch: dict[str, Any]) -> Tensor:
        """(B, T, 1) whether a frame is given."""
        motion: Tensor = batch["motion"]
        frame = torch.arange(motion.shape[1], device=motion.device)[:, None]
        known: Tensor = batch.get("known", torch.zeros(1, dtype=torch.long, device=motion.device))
        return frame < known[:, None, None]

    def _estimate(self, batch: dict[str, Any], step: Tensor, noisy: Tensor) -> Tensor:
        guess: Tensor = self.model(
            noisy,
            step,
            audio=batch["audio"],
            emotion=batch["emotion"],
            intensity=batch["intensity"],
            valid=batch["valid"],
            drop_audio=batch.get("drop_audio"),
            drop_affect=batch.get("drop_affect"),
            first_position=batch.get("first_position"),
            known=batch.get("known"),
        )
        return guess.float()

    def _normalised(self, batch: dict[str, Any]) -> Tensor:
        """Motion in units of its spread, 0 on padding; (B, T, 204)."""
        normalised: Tensor = (batch["motion"] - self.mean) / self.spread
        return normalised * batch["valid"][..., None]

    def _statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and spread of each coordinate over what the sampler draws."""
        rng = np.random.default_rng(VALIDATION_SEED)
        drawn = [self.corpus.landmarks(self.sampler.draw(rng)) for _ in range(600)]
        frames = np.concatenate([m[rng.integers(0, len(m), 100)] for m in drawn])
        self.usual_opening = usual_opening(frames)
        return mean_and_spread(frames.reshape(len(frames), -1))
