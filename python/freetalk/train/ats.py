"""Training of the audio-to-landmarks denoiser [FreeTalk 3.1, 3.3, supp. 2]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.ats import Ats, AtsOptions, GenerateOptions, generate
from freetalk.data import (
    NUM_LANDMARKS,
    Dataset,
    MotionSequence,
    lip_opening,
)
from freetalk.data.landmarks import (
    INNER_LIP_PAIRS,
    LIPS,
    LOWER_INNER_LIP,
    UPPER_FACE,
    UPPER_INNER_LIP,
)
from freetalk.diffusion import Schedule, ScheduleOptions
from freetalk.train.assemble import encoder_record
from freetalk.train.ats_inputs import audible, frame_rate, speech_encoder
from freetalk.train.ats_windows import AtsWindows
from freetalk.train.checkpoint import export_model
from freetalk.train.checks import NO_VALIDATION
from freetalk.train.config import TrainingConfig
from freetalk.train.features import FeatureCache
from freetalk.train.losses import (
    MILLIMETRES,
    closure_error,
    closures,
    landmark_weights,
    motion_counts,
    motion_loss,
    vertex_errors,
)
from freetalk.train.mosaic import blended
from freetalk.train.previews import MeanFace, Sample, sample_of
from freetalk.train.sequences import Epochs, SequenceSampler, numpy_generator, present_weights
from freetalk.train.task_options import AtsTaskOptions

_VALIDATION_SEED = 30
# Frames and denoising steps of a sample to look at.
_SAMPLE_FRAMES, _SAMPLE_STEPS = 90, 25
# Of each clip that validation samples with DPM-Solver++.
_SAMPLED_FRAMES, _SAMPLED_STEPS = 300, 15
_VALIDATION_TIMESTEPS = (0.15, 0.5, 0.85, 1.0)
#: Smallest spread that a coordinate is divided by, relative to the mean one.
_SPREAD_FLOOR = 0.15


class AtsTask:
    """Windows of motion with their speech features; the denoiser restores them from noise."""

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, AtsTaskOptions)
        self.options = config.task
        self.corpus = corpus.at(frame_rate(config.model, config.task.source_weights, corpus))
        self.batch_size = config.loop.batch_size
        self.device = device
        self._out = out
        self._face: MeanFace | None = None
        train = audible(self.corpus.sequences("train"))
        shares = present_weights((s.source for s in train), self.options.source_weights)
        self.sampler = SequenceSampler(train, shares)
        sources = {s.source for s in self.sampler.sequences}
        heard = audible(self.corpus.sequences("val"))
        self.held_out = [s for s in heard if s.source in sources] or heard
        if not self.held_out:
            raise ValueError(NO_VALIDATION.format(corpus.name, "sequences with sound"))
        encoder = speech_encoder(self.options, out)
        self._encoder = encoder_record(encoder)
        self.features = FeatureCache(
            self.corpus,
            [*self.sampler.sequences, *self.held_out],
            encoder,
            Path(self.options.feature_cache or out / "cache"),
            self.options.feature_augmentations,
            device,
            self.options.voices,
        )
        fields = {"audio_dim": self.features.width, **config.model, "fps": self.corpus.fps}
        if fields["audio_dim"] != self.features.width:
            raise ValueError(
                f"model.audio_dim is {fields['audio_dim']}, but the encoder in {encoder} gives "
                f"{self.features.width} channels; leave model.audio_dim out"
            )
        self.model_options = AtsOptions.from_dict(fields)
        self.windows = AtsWindows(
            self.options,
            self.corpus,
            self.features,
            self.sampler.sequences,
            shares,
            self.model_options.max_frames,
        )
        self.model_options.trained_frames = self.windows.longest()
        # The same start, whether the features were cached or not.
        torch.manual_seed(config.loop.seed)
        self.model = Ats(self.model_options).to(device)
        self.model.set_motion_statistics(*self._statistics())
        self.schedule = Schedule(
            ScheduleOptions(
                kind=self.model_options.schedule,
                num_steps=self.model_options.num_train_steps,
                beta_start=self.model_options.beta_start,
                beta_end=self.model_options.beta_end,
            )
        )
        self.epochs = Epochs(
            self.sampler.sequences, self.model_options.max_frames, config.loop.seed
        )
        self._in_epochs = config.loop.epochs > 0
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
        """A window of up to ``max_frames`` frames, its noise and its diffusion step."""
        if self._in_epochs:
            sequence, start = self.epochs.window(number)
            window = self.windows.cut(sequence, rng, start)
        else:
            window = self.windows.cut(self.sampler.draw(rng), rng)
        if rng.random() < self.options.blend:
            window = blended(window, self.windows.cut(self.sampler.draw(rng), rng), rng)
        spare = self.model_options.max_frames - len(window["motion"])
        return {
            **window,
            "first_position": int(rng.integers(spare + 1)) if self.options.position_offsets else 0,
            "drop_audio": rng.random() < self.options.audio_dropout,
            "drop_affect": rng.random() < self.options.affect_dropout,
            "rehearsed": rng.random() < self.options.rehearsal,
            "step": self._diffusion_step(rng),
            "noise": rng.standard_normal(window["motion"].shape, dtype=np.float32),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Windows padded to the longest; padding has no noise."""
        batch = self.windows.stack(items)
        noise = torch.zeros_like(batch["motion"])
        for row, item in enumerate(items):
            noise[row, : len(item["noise"])] = torch.from_numpy(item["noise"])
        for name in ("drop_audio", "drop_affect", "step", "first_position"):
            batch[name] = torch.tensor([item[name] for item in items])
        rehearsed = [row for row, item in enumerate(items) if item["rehearsed"]]
        batch["rehearsed"] = torch.tensor(rehearsed, dtype=torch.int64)
        wanted = _gap(batch["motion"])
        closed = closures(wanted, batch["valid"], self._usual_opening).sum()
        counts = torch.cat([motion_counts(batch["valid"]), closed[None].float()])
        return {**batch, "noise": noise, "counts": counts}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 at the diffusion step drawn for each window."""
        return self._terms(batch, batch["step"], batch["noise"])

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Windows at fixed steps and noise, and clips sampled as a user would."""
        generator = torch.Generator().manual_seed(_VALIDATION_SEED)
        rng = numpy_generator(generator)
        sampler = SequenceSampler(self.held_out, {s.source: 1.0 for s in self.held_out})
        count, size = self.options.validation_windows, self.batch_size
        items = [self.windows.cut(sampler.draw(rng), rng, altered=False) for _ in range(count)]
        records: list[tuple[int, Any]] = []
        for number, first in enumerate(range(0, count, size)):
            stacked = self.windows.stack(items[first : first + size])
            noise = torch.randn(stacked["motion"].shape, generator=generator)
            if number % parts == part:
                records.append((number, self._denoised({**stacked, "noise": noise})))
        for number, clip in enumerate(self._sampled_clips()):
            if number % parts == part:
                records.append((count + number, self._sampled(clip, number)))
        return records

    def _denoised(self, stacked: dict[str, Any]) -> dict[str, Any]:
        """Losses at fixed diffusion steps, and the opening that is guessed from noise."""
        batch = {name: value.to(self.device) for name, value in stacked.items()}
        noise, losses = batch["noise"], []
        for share in _VALIDATION_TIMESTEPS:
            index = round(share * (self.model_options.num_train_steps - 1))
            step = torch.full((len(noise),), index, device=self.device)
            losses.append(float(self._terms(batch, step, noise)["loss"]))
        guess = self._denoise(batch, step, noise)  # the last step is pure noise
        openings = [_gap(guess * self.spread + self.mean), _gap(batch["motion"])]
        return {"losses": losses, "openings": [one[batch["valid"]].cpu() for one in openings]}

    def _sampled_clips(self) -> list[MotionSequence]:
        """Held-out clips with sound, spread over the split."""
        heard = [s for s in self.held_out if s.has_sound]
        at = np.linspace(0, len(heard) - 1, min(self.options.validation_samples, len(heard)))
        return [heard[int(index)] for index in at.round()]

    def _sampled(self, clip: MotionSequence, seed: int) -> dict[str, Any]:
        """Errors and opening of a clip that is spoken from noise, against the recorded motion."""
        copy = self.features.copies(clip)[0]
        features = torch.from_numpy(self.features.features(copy, 0, _SAMPLED_FRAMES))
        emotion = torch.zeros(len(self.corpus.emotions))
        emotion[clip.emotion] = 1.0
        options = GenerateOptions(sampler="dpmpp", num_steps=_SAMPLED_STEPS)
        motion = generate(
            self.model,
            features.to(self.device),
            emotion=emotion.to(self.device),
            intensity=float(clip.intensity),
            options=options,
            seed=seed,
        ).cpu()
        true = torch.from_numpy(self.corpus.landmarks(clip, 0, len(motion)))
        motion = motion[: len(true)]
        return {
            "sampled": [*vertex_errors(motion, true, LIPS), len(true)],
            "openings": [torch.from_numpy(lip_opening(one.numpy())) for one in (motion, true)],
        }

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Loss, the opening's correlation, and the same of sampled clips with LVE and MVE of the landmarks."""
        loss = float(np.mean([value for one in records for value in one.get("losses", [])]))
        found = {"loss": loss, "opening_correlation": _correlation(records, "losses")}
        sampled = np.array([one["sampled"] for one in records if "sampled" in one])
        if len(sampled):
            means = np.average(sampled[:, :2], axis=0, weights=sampled[:, 2])
            found["sampled_lve_mm2"], found["sampled_mve_mm"] = map(float, means)
            found["sampled_opening_correlation"] = _correlation(records, "sampled")
        return {**found, "score": loss}

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options; the motion statistics keep full precision."""
        config = {
            "format": "freetalk-ats",
            "version": 1,
            "options": self.model.options.to_dict(),
            "emotions": list(self.corpus.emotions),
            "fps": self.corpus.fps,
            "training": {
                **training,
                "data": self.corpus.describe(),
                "speech_encoder": self._encoder,
            },
        }
        export_model(directory, config, dict(self.model.state_dict()), keep_float32=("motion_",))

    def sample(self) -> Sample:
        """The mean face speaking the first held-out take with sound, and its true motion."""
        sequence = next((s for s in self.held_out if s.has_sound), self.held_out[0])
        copy = self.features.copies(sequence)[0]
        features = torch.from_numpy(self.features.features(copy, 0, _SAMPLE_FRAMES))
        emotion = torch.zeros(len(self.corpus.emotions))
        emotion[sequence.emotion] = 1.0
        motion = generate(
            self.model,
            features.to(self.device),
            emotion=emotion.to(self.device),
            intensity=float(sequence.intensity),
            options=GenerateOptions(num_steps=_SAMPLE_STEPS),
            seed=_VALIDATION_SEED,
        )
        if self._face is None:
            self._face = MeanFace(self._out / "stm", self.device)
        return sample_of(self._face, self.corpus, sequence, motion)

    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        o = self.options
        target = self._normalised(batch)
        guess = self._denoise(batch, step, noise)
        counts: Tensor | None = batch.get("counts")
        motion = None if counts is None else counts[:3]
        opening = _gap(guess * self.spread + self.mean)
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
            motion,
        )
        if o.opening_weight > 0:
            upper, lower = INNER_LIP_PAIRS
            gap = guess[..., upper, :] - guess[..., lower, :]
            wanted = target[..., upper, :] - target[..., lower, :]
            terms["opening"] = motion_loss(gap, wanted, batch["valid"], counts=motion)["loss"]
            terms["loss"] = terms["loss"] + o.opening_weight * terms["opening"]
        if o.closure_weight > 0:
            terms["closure"] = closure_error(
                opening,
                _gap(batch["motion"]),
                batch["valid"],
                self._usual_opening,
                None if counts is None else counts[3],
            )
            terms["loss"] = terms["loss"] + o.closure_weight * terms["closure"]
        return terms

    def _denoise(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> Tensor:
        clean = self._normalised(batch)
        rows: Tensor | None = batch.get("rehearsed")
        if rows is not None and len(rows):
            whole = ("counts", "rehearsed")
            some = {name: value[rows] for name, value in batch.items() if name not in whole}
            with torch.no_grad():
                last = torch.full_like(step[rows], self.model_options.num_train_steps - 1)
                own = self._estimate(some, last, noise[rows]) * some["valid"][..., None]
            clean[rows] = torch.where(self.mouth, own, clean[rows])
        return self._estimate(batch, step, self.schedule.q_sample(clean, step, noise=noise))

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
        )
        return guess.float()

    def _diffusion_step(self, rng: np.random.Generator) -> int:
        steps = self.model_options.num_train_steps
        return min(int(steps * rng.random() ** (1 / self.options.step_power)), steps - 1)

    def _normalised(self, batch: dict[str, Any]) -> Tensor:
        """Motion in units of its spread, 0 on padding; (B, T, 204)."""
        normalised: Tensor = (batch["motion"] - self.mean) / self.spread
        return normalised * batch["valid"][..., None]

    def _statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and spread of each coordinate over what the sampler draws."""
        rng = np.random.default_rng(_VALIDATION_SEED)
        drawn = [self.corpus.landmarks(self.sampler.draw(rng)) for _ in range(600)]
        frames = np.concatenate([m[rng.integers(0, len(m), 100)] for m in drawn])
        self._usual_opening = float(np.sqrt(np.square(lip_opening(frames)).mean()))
        frames = frames.reshape(len(frames), -1)
        spread = frames.std(axis=0)
        spread = np.maximum(spread, _SPREAD_FLOOR * spread.mean()).clip(1e-6)
        return torch.from_numpy(frames.mean(axis=0)).float(), torch.from_numpy(spread).float()


def _gap(motion: Tensor) -> Tensor:
    """Opening (..., T) of the inner lips in motion (..., T, 204)."""
    points = motion.unflatten(-1, (NUM_LANDMARKS, 3))
    return points[..., UPPER_INNER_LIP, 1] - points[..., LOWER_INNER_LIP, 1]


def _correlation(records: list[Any], kind: str) -> float:
    """Of guessed and true opening over all records of a kind."""
    openings = [one["openings"] for one in records if kind in one]
    guessed, true = (torch.cat(side).numpy() for side in zip(*openings, strict=True))
    with np.errstate(invalid="ignore"):
        return float(np.corrcoef(guessed, true)[0, 1])
