"""What the trainings of denoisers share: windows, noise and diffusion steps, their validation and samples."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.ats import Ats, AtsOptions
from freetalk.data import Dataset, MotionSequence, lip_opening
from freetalk.data.landmarks import INNER_LIP_PAIRS, LIPS, LOWER_INNER_LIP, UPPER_INNER_LIP
from freetalk.data.pack import FloatArray
from freetalk.diffusion import Schedule, ScheduleOptions
from freetalk.facetalk import FaceTalk, FaceTalkOptions
from freetalk.train.assemble import encoder_record
from freetalk.train.checkpoint import NO_VALIDATION, export_model
from freetalk.train.config import LoopOptions, TrainingConfig
from freetalk.train.features import FeatureCache
from freetalk.train.initial import audible, frame_rate, speech_encoder
from freetalk.train.losses import (
    LEAST_OPENING,
    closure_error,
    closures,
    motion_counts,
    motion_loss,
    vertex_errors,
)
from freetalk.train.mosaic import blended
from freetalk.train.previews import MeanFace, Sample, sample_of
from freetalk.train.sequences import Epochs, SequenceSampler, numpy_generator, present_weights
from freetalk.train.task_options import DenoisingTaskOptions
from freetalk.train.windows import Windows, padded

#: Of the statistics and of the validation.
VALIDATION_SEED = 30
_VALIDATION_TIMESTEPS = (0.15, 0.5, 0.85, 1.0)
# Denoising steps of a sample to look at.
_SAMPLE_STEPS = 25
# Of each clip that validation samples with DPM-Solver++.
_SAMPLED_FRAMES, _SAMPLED_STEPS = 300, 15
#: Smallest spread that a value is divided by, relative to the mean one.
_SPREAD_FLOOR = 0.15


class DenoisingTask(ABC):
    """Windows of motion with what is heard; a denoiser restores them from noise.

    A subclass builds its model options and windows, calls :meth:`_begin`, measures its statistics and defines
    what it draws of a window, its loss and how it speaks.

    Args:
        config: of the training.
        corpus: the data.
        out: the training's output folder.
        device: of the model.
        model: the model's options that are given.
        hears: whether it hears sound.

    Raises:
        ValueError: there is nothing to validate on.
    """

    options: DenoisingTaskOptions
    model: Ats | FaceTalk
    model_options: AtsOptions | FaceTalkOptions
    windows: Windows
    usual_opening: float
    #: Frames of a sample to look at.
    sample_frames: int
    #: Start of the names of the weights that are exported in full precision.
    full_precision: tuple[str, ...]

    def __init__(
        self,
        config: TrainingConfig,
        corpus: Dataset,
        out: Path,
        device: torch.device,
        model: dict[str, Any],
        hears: bool = True,
    ) -> None:
        o = self.options
        self.kind = config.kind
        self.corpus = corpus.at(frame_rate(model, o.source_weights, corpus))
        self.batch_size = config.loop.batch_size
        self.device = device
        self._out = out
        self._face: MeanFace | None = None
        self._encoder: dict[str, str] = {}
        train, heard = (self.corpus.sequences(split) for split in ("train", "val"))
        if hears:
            train, heard = audible(train), audible(heard)
        self._shares = present_weights((s.source for s in train), o.source_weights)
        self.sampler = SequenceSampler(train, self._shares)
        sources = {s.source for s in self.sampler.sequences}
        self.held_out = [s for s in heard if s.source in sources] or heard
        if not self.held_out:
            raise ValueError(NO_VALIDATION.format(corpus.name, "sequences with sound"))

    def _speech_features(self, resampling: str = "output") -> FeatureCache:
        """Of all sequences; see :class:`FeatureCache`."""
        encoder = speech_encoder(self.options, self._out)
        self._encoder = encoder_record(encoder)
        return FeatureCache(
            self.corpus,
            [*self.sampler.sequences, *self.held_out],
            encoder,
            Path(self.options.feature_cache or self._out / "cache"),
            self.options.feature_augmentations,
            self.device,
            self.options.voices,
            resampling,
        )

    def _begin(self, loop: LoopOptions, network: Callable[[Any], Any], frames: int) -> None:
        """The model with its initial weights, its schedule, and epochs of windows of so many frames."""
        # The same start, whether the features were cached or not.
        torch.manual_seed(loop.seed)
        self.model = network(self.model_options).to(self.device)
        self.schedule = Schedule(
            ScheduleOptions(
                kind=self.model_options.schedule,
                num_steps=self.model_options.num_train_steps,
                beta_start=self.model_options.beta_start,
                beta_end=self.model_options.beta_end,
            )
        )
        self.epochs = Epochs(self.sampler.sequences, frames, loop.seed)
        self._in_epochs = loop.epochs > 0

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """A window, its noise and its diffusion step."""
        if self._in_epochs:
            sequence, start = self.epochs.window(number)
            window = self.windows.cut(sequence, rng, start)
        else:
            window = self.windows.cut(self.sampler.draw(rng), rng)
        if rng.random() < self.options.blend:
            window = blended(window, self.windows.cut(self.sampler.draw(rng), rng), rng)
        window |= self._drawn(rng, len(window["motion"]))
        noise = rng.standard_normal(window["motion"].shape, dtype=np.float32)
        return {**window, "noise": noise}

    @abstractmethod
    def _drawn(self, rng: np.random.Generator, frames: int) -> dict[str, Any]:
        """``step`` and what else is drawn for a window of so many frames."""

    def _diffusion_step(self, rng: np.random.Generator) -> int:
        steps = self.model_options.num_train_steps
        return min(int(steps * rng.random() ** (1 / self.options.step_power)), steps - 1)

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Windows padded to the longest; padding has no noise."""
        batch: dict[str, Any] = self.windows.stack(items)
        batch["noise"] = padded([item["noise"] for item in items])
        for name in [name for name in items[0] if name not in {*batch, "motion"}]:
            batch[name] = torch.tensor([item[name] for item in items])
        closed = closures(
            self._opening(batch[self.windows.target]), batch["valid"], self.usual_opening
        ).sum()
        batch["counts"] = torch.cat([motion_counts(batch["valid"]), closed[None].float()])
        return batch

    @abstractmethod
    def _opening(self, motion: Tensor) -> Tensor:
        """Opening (B, T) of the inner lips, m, of motion (B, T, Z) on the host."""

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """The motion's error [FreeTalk, Eq. 15; FaceTalk, Eq. 4] at the diffusion step drawn for each window."""
        return self._terms(batch, batch["step"], batch["noise"])

    @abstractmethod
    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Terms of the loss of a batch at a diffusion step (B,), with a noise (B, T, Z)."""

    def _with_lips(
        self,
        terms: dict[str, Tensor],
        batch: dict[str, Any],
        gaps: tuple[Tensor, Tensor],
        openings: tuple[Tensor, Tensor],
    ) -> dict[str, Tensor]:
        """The terms and those on the inner lips that are asked for, of guessed and true gaps and openings."""
        o, valid, counts = self.options, batch["valid"], batch.get("counts")
        if o.opening_weight > 0:
            terms["opening"] = motion_loss(*gaps, valid, counts=counts)["loss"]
            terms["loss"] = terms["loss"] + o.opening_weight * terms["opening"]
        if o.closure_weight > 0:
            closed = None if counts is None else counts[3]
            terms["closure"] = closure_error(*openings, valid, self.usual_opening, closed)
            terms["loss"] = terms["loss"] + o.closure_weight * terms["closure"]
        return terms

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Windows at fixed steps and noise, and clips sampled as a user would."""
        generator = torch.Generator().manual_seed(VALIDATION_SEED)
        rng = numpy_generator(generator)
        sampler = SequenceSampler(self.held_out, {s.source: 1.0 for s in self.held_out})
        count, size = self.options.validation_windows, self.batch_size
        items = [self.windows.cut(sampler.draw(rng), rng, altered=False) for _ in range(count)]
        records: list[tuple[int, Any]] = []
        for number, first in enumerate(range(0, count, size)):
            stacked = self.windows.stack(items[first : first + size])
            stacked["noise"] = torch.randn(stacked[self.windows.target].shape, generator=generator)
            if number % parts == part:
                batch = {name: value.to(self.device) for name, value in stacked.items()}
                records.append((number, self._denoised(batch)))
        heard = self._speaking()
        at = np.linspace(0, len(heard) - 1, min(self.options.validation_samples, len(heard)))
        for number, index in enumerate(at.round()):
            if number % parts == part:
                records.append((count + number, self._sampled(heard[int(index)], number)))
        return records

    def _denoised(self, batch: dict[str, Any]) -> dict[str, Any]:
        """Losses at fixed diffusion steps."""
        steps = [self._step_at(share, batch) for share in _VALIDATION_TIMESTEPS]
        losses = [float(self._terms(batch, step, batch["noise"])["loss"]) for step in steps]
        return {"losses": losses}

    def _step_at(self, share: float, batch: dict[str, Any]) -> Tensor:
        """(B,) the diffusion step at a share of all of them."""
        index = round(share * (self.model_options.num_train_steps - 1))
        return torch.full((len(batch["noise"]),), index, device=self.device)

    def _speaking(self) -> list[MotionSequence]:
        """Held-out clips with sound."""
        return [s for s in self.held_out if s.has_sound]

    def _sampled(self, clip: MotionSequence, seed: int) -> dict[str, Any]:
        """Errors and opening of a clip that is spoken from noise, against the recorded motion."""
        drawn = {"sampler": "dpmpp", "num_steps": _SAMPLED_STEPS}
        motion = self._spoken(clip, _SAMPLED_FRAMES, drawn, seed).cpu()
        true = torch.from_numpy(self.corpus.landmarks(clip, 0, len(motion)))
        motion = motion[: len(true)]
        return {
            "sampled": [*vertex_errors(motion, true, LIPS), len(true)],
            "openings": [lip_opening(one.numpy()) for one in (motion, true)],
        }

    @abstractmethod
    def _spoken(
        self, clip: MotionSequence, frames: int, drawn: dict[str, Any], seed: int
    ) -> Tensor:
        """Landmark displacements (T, 68, 3), m, that are sampled for a clip, with these generation options."""

    def _heard(self, clip: MotionSequence, frames: int) -> Tensor:
        """What is heard in the first frames of a clip, (T, C)."""
        return torch.from_numpy(self.windows.heard(clip, 0, frames)).to(self.device)

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Loss, the opening's correlation, and the same of sampled clips with LVE and MVE of the landmarks."""
        loss = float(np.mean([value for one in records for value in one.get("losses", [])]))
        found = {"loss": loss, **_correlation(records, "losses", "opening_correlation")}
        sampled = np.array([one["sampled"] for one in records if "sampled" in one])
        if len(sampled):
            means = np.average(sampled[:, :2], axis=0, weights=sampled[:, 2])
            found["sampled_lve_mm2"], found["sampled_mve_mm"] = map(float, means)
            found |= _correlation(records, "sampled", "sampled_opening_correlation")
        return {**found, "score": loss}

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options; statistics keep full precision."""
        config = {
            "format": f"freetalk-{self.kind}",
            "version": 1,
            "options": self.model.options.to_dict(),
            **self._described(),
            "fps": self.corpus.fps,
            "training": {
                **training,
                "data": self.corpus.describe(),
                "speech_encoder": self._encoder,
            },
        }
        state = dict(self.model.state_dict())
        export_model(directory, config, state, keep_float32=self.full_precision)

    def _described(self) -> dict[str, Any]:
        """What else is exported of the data."""
        return {}

    def sample(self) -> Sample:
        """The mean face speaking the first held-out take with sound, and its true motion."""
        sequence = next((s for s in self.held_out if s.has_sound), self.held_out[0])
        drawn = {"num_steps": _SAMPLE_STEPS}
        spoken = self._spoken(sequence, self.sample_frames, drawn, VALIDATION_SEED)
        if self._face is None:
            self._face = MeanFace(self._out / "stm", self.device)
        return sample_of(self._face, self.corpus, sequence, spoken)


def usual_opening(landmarks: FloatArray) -> float:
    """Root mean square of the opening of landmarks (..., 68, 3), m."""
    return max(float(np.sqrt(np.square(lip_opening(landmarks)).mean())), LEAST_OPENING)


def mean_and_spread(values: FloatArray) -> tuple[Tensor, Tensor]:
    """Mean and standard deviation (Z,) of values (N, Z); what hardly varies has a share of the mean deviation."""
    spread = values.std(axis=0)
    spread = np.maximum(spread, _SPREAD_FLOOR * spread.mean()).clip(1e-6)
    return torch.from_numpy(values.mean(axis=0)).float(), torch.from_numpy(spread).float()


def opening(landmarks: Tensor) -> Tensor:
    """Opening (...) of the inner lips in landmarks (..., 68, 3)."""
    return landmarks[..., UPPER_INNER_LIP, 1] - landmarks[..., LOWER_INNER_LIP, 1]


def lip_gaps(landmarks: Tensor) -> Tensor:
    """(..., pairs, 3) from the lower to the upper inner lip in landmarks (..., 68, 3)."""
    upper, lower = INNER_LIP_PAIRS
    return landmarks[..., upper, :] - landmarks[..., lower, :]


def _correlation(records: list[Any], kind: str, name: str) -> dict[str, float]:
    """Of guessed and true opening over all records of a kind that have them."""
    openings = [one["openings"] for one in records if kind in one and "openings" in one]
    if not openings:
        return {}
    guessed, true = (np.concatenate(side) for side in zip(*openings, strict=True))
    with np.errstate(invalid="ignore"):
        return {name: float(np.corrcoef(guessed, true)[0, 1])}
