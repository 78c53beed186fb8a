"""Training of the audio-to-landmarks denoiser [FreeTalk 3.1, 3.3, supp. 2]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from tqdm import tqdm

from freetalk._pretrained import PRETRAINED
from freetalk.ats import Ats, AtsOptions, GenerateOptions, generate
from freetalk.data import NUM_LANDMARKS, MotionDataset, MotionSequence, interpolate_frames
from freetalk.data.landmarks import (
    EYES,
    INNER_LIP_PAIRS,
    LIPS,
    LOWER_INNER_LIP,
    UPPER_FACE,
    UPPER_INNER_LIP,
)
from freetalk.diffusion import Schedule, ScheduleOptions
from freetalk.train.checkpoint import export_model
from freetalk.train.config import TrainingConfig
from freetalk.train.features import FeatureCache
from freetalk.train.initial import initial_weights
from freetalk.train.losses import closure_error, motion_counts, motion_loss
from freetalk.train.mosaic import FloatArray, Mosaics, blended
from freetalk.train.samples import MeanFace, Sample
from freetalk.train.sampling import SequenceSampler, numpy_generator
from freetalk.train.task_options import AtsTaskOptions

_VALIDATION_SEED = 30
#: Frames and denoising steps of a sample to look at.
_SAMPLE_FRAMES = 90
_SAMPLE_STEPS = 25
_VALIDATION_TIMESTEPS = (0.15, 0.5, 0.85, 1.0)
#: Smallest spread that a coordinate is divided by, relative to the mean one.
_SPREAD_FLOOR = 0.15


class AtsTask:
    """Windows of motion with their speech features; the denoiser restores them from noise."""

    def __init__(
        self, config: TrainingConfig, corpus: MotionDataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, AtsTaskOptions)
        self.options = config.task
        self.corpus = corpus
        self.batch_size = config.loop.batch_size
        self.device = device
        self._out = out
        self._face: MeanFace | None = None
        train = _audible(corpus.sequences("train"))
        self.sampler = SequenceSampler(train, self.options.source_weights)
        self.mosaics = Mosaics(self.sampler.sequences, self.options.source_weights)
        sources = {s.source for s in self.sampler.sequences}
        self.held_out = [s for s in _audible(corpus.sequences("val")) if s.source in sources]
        encoder = _speech_encoder(self.options, out)
        cache = Path(self.options.feature_cache or out / "cache")
        self.features = FeatureCache(
            corpus,
            [*self.sampler.sequences, *self.held_out],
            encoder,
            cache,
            self.options.feature_augmentations,
            device,
        )
        # Every frame is looked at once, so that what is wrong with one is told before, not at night.
        every = [*self.sampler.sequences, *self.held_out]
        for sequence in tqdm(every, desc="landmarks", unit="take", leave=False):
            corpus.landmarks(sequence, 0, 1)
        fields = {"audio_dim": self.features.width, **config.model}
        if fields["audio_dim"] != self.features.width:
            raise ValueError(
                f"model.audio_dim is {fields['audio_dim']}, but the encoder in {encoder} gives "
                f"{self.features.width} channels; leave model.audio_dim out"
            )
        self.model_options = AtsOptions.from_dict(fields)
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
        self.point_weights = self._landmark_weights()
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

    def item(self, rng: np.random.Generator) -> dict[str, Any]:
        """A window of up to ``max_frames`` frames, its noise and its diffusion step."""
        window = self._window(self.sampler.draw(rng), rng)
        if rng.random() < self.options.blend:
            window = blended(window, self._window(self.sampler.draw(rng), rng), rng)
        return {
            **window,
            "drop_audio": rng.random() < self.options.audio_dropout,
            "drop_affect": rng.random() < self.options.affect_dropout,
            "rehearsed": rng.random() < self.options.rehearsal,
            "step": self._diffusion_step(rng),
            "noise": rng.standard_normal(window["motion"].shape, dtype=np.float32),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Windows padded to the longest; padding has no noise."""
        batch = self._stack(items)
        noise = torch.zeros_like(batch["motion"])
        for row, item in enumerate(items):
            noise[row, : len(item["noise"])] = torch.from_numpy(item["noise"])
        for name in ("drop_audio", "drop_affect", "rehearsed", "step"):
            batch[name] = torch.tensor([item[name] for item in items])
        return {**batch, "noise": noise, "counts": motion_counts(batch["valid"])}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 at the diffusion step drawn for each window."""
        return self._terms(batch, batch["step"], batch["noise"])

    def validate(self) -> dict[str, float]:
        """Loss at fixed steps and noise, and the opening's correlation when starting from noise."""
        if not self.held_out:
            raise ValueError("the corpus has no sequences with audio in its val split")
        generator = torch.Generator().manual_seed(_VALIDATION_SEED)
        rng = numpy_generator(generator)
        sampler = SequenceSampler(self.held_out, {s.source: 1.0 for s in self.held_out})
        count = self.options.validation_windows
        items = [self._window(sampler.draw(rng), rng, altered=False) for _ in range(count)]
        losses: list[float] = []
        gaps: list[tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]] = []
        for first in range(0, count, self.batch_size):
            stacked = self._stack(items[first : first + self.batch_size])
            batch = {name: value.to(self.device) for name, value in stacked.items()}
            noise = torch.randn(batch["motion"].shape, generator=generator).to(self.device)
            for share in _VALIDATION_TIMESTEPS:
                index = round(share * (self.model_options.num_train_steps - 1))
                step = torch.full((len(noise),), index, device=self.device)
                terms = self._terms(batch, step, noise)
                losses.append(float(terms["loss"]))
            guess = self._denoise(batch, step, noise)  # the last step is pure noise
            valid = batch["valid"]
            gaps.append(
                (
                    self._gap(guess)[valid].cpu().numpy(),
                    self._gap(self._normalised(batch))[valid].cpu().numpy(),
                )
            )
        guessed, true = (np.concatenate(side) for side in zip(*gaps, strict=True))
        correlation = np.corrcoef(guessed, true)
        loss = float(np.mean(losses))
        return {"loss": loss, "opening_correlation": float(correlation[0, 1]), "score": loss}

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options; the motion statistics keep full precision."""
        config = {
            "format": "freetalk-ats",
            "version": 1,
            "options": self.model.options.to_dict(),
            "emotions": list(self.corpus.emotions),
            "fps": self.corpus.fps,
            "training": {**training, "data": self.corpus.describe()},
        }
        export_model(directory, config, dict(self.model.state_dict()), keep_float32="motion_")

    def sample(self) -> Sample:
        """The mean face speaking the first held-out take with sound, and its true motion."""
        sequence = next((s for s in self.held_out if s.audio is not None), self.held_out[0])
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
        true = torch.from_numpy(self.corpus.landmarks(sequence, 0, len(features)))
        rate = self.corpus.sample_rate_hz
        return Sample(
            vertices=self._face.vertices,
            faces=self._face.faces,
            predicted=self._face.moved(motion),
            true=self._face.moved(true),
            fps=sequence.fps,
            audio=self.corpus.audio(sequence)[: round(len(features) / sequence.fps * rate)],
            sample_rate_hz=rate,
        )

    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        o = self.options
        target = self._normalised(batch)
        guess = self._denoise(batch, step, noise)
        if o.loss_units == "metres":
            guess, target = guess * self.spread, target * self.spread  # the mean cancels
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
        if o.opening_weight > 0:
            upper, lower = INNER_LIP_PAIRS
            gap = guess[..., upper, :] - guess[..., lower, :]
            wanted = target[..., upper, :] - target[..., lower, :]
            terms["opening"] = motion_loss(gap, wanted, batch["valid"], counts=batch.get("counts"))[
                "loss"
            ]
            terms["loss"] = terms["loss"] + o.opening_weight * terms["opening"]
        if o.closure_weight > 0:
            unit = self.spread if o.loss_units == "metres" else 1.0
            opening = self._gap(guess.flatten(-2) / unit)
            wanted = self._gap(target.flatten(-2) / unit)
            terms["closure"] = closure_error(opening, wanted, batch["valid"])
            terms["loss"] = terms["loss"] + o.closure_weight * terms["closure"]
        return terms

    def _denoise(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> Tensor:
        clean = self._normalised(batch)
        rehearsed: Tensor | None = batch.get("rehearsed")
        if rehearsed is not None and bool(rehearsed.any()):
            rows = rehearsed.nonzero()[:, 0]
            some = {name: value[rows] for name, value in batch.items() if name != "counts"}
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
        )
        return guess.float()

    def _window(
        self, sequence: MotionSequence, rng: np.random.Generator, altered: bool = True
    ) -> dict[str, Any]:
        def piece(source: MotionSequence, frames: int) -> tuple[FloatArray, FloatArray]:
            copies = self.features.copies(source)
            copy = copies[int(rng.integers(len(copies)))] if altered else copies[0]
            start = int(rng.integers(0, max(1, copy.num_frames - frames + 1)))
            audio = self.features.features(copy, start, start + frames)
            at = (start + np.arange(len(audio))) * copy.speed
            first, stop = int(at[0]), int(at[-1]) + 2
            return audio, interpolate_frames(self.corpus.landmarks(source, first, stop), at - first)

        length = self.model_options.max_frames
        if altered and rng.random() < self.options.mosaic:
            audio, motion = self.mosaics.window(sequence, length, piece, rng)
        else:
            audio, motion = piece(sequence, length)
        if altered:
            o = self.options
            audio = self.features.altered(
                audio, o.feature_noise, o.feature_shift, o.feature_dropout, rng
            )
        return {
            "audio": audio,
            "motion": motion.reshape(len(motion), -1),
            "emotion": np.eye(len(self.corpus.emotions), dtype=np.float32)[sequence.emotion],
            "intensity": sequence.intensity,
        }

    def _diffusion_step(self, rng: np.random.Generator) -> int:
        steps = self.model_options.num_train_steps
        return min(int(steps * rng.random() ** (1 / self.options.step_power)), steps - 1)

    def _stack(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        longest = max(len(item["motion"]) for item in items)
        audio = torch.zeros(len(items), longest, self.features.width)
        motion = torch.zeros(len(items), longest, 3 * NUM_LANDMARKS)
        valid = torch.zeros(len(items), longest, dtype=torch.bool)
        emotion = torch.zeros(len(items), len(self.corpus.emotions))
        for row, item in enumerate(items):
            frames = len(item["motion"])
            audio[row, :frames] = torch.from_numpy(item["audio"])
            motion[row, :frames] = torch.from_numpy(item["motion"])
            valid[row, :frames] = True
            emotion[row] = torch.from_numpy(item["emotion"])
        intensity = torch.tensor([item["intensity"] for item in items], dtype=torch.float32)
        return {
            "audio": audio,
            "motion": motion,
            "valid": valid,
            "emotion": emotion,
            "intensity": intensity,
        }

    def _normalised(self, batch: dict[str, Any]) -> Tensor:
        """Motion in units of its spread, 0 on padding; (B, T, 204)."""
        normalised: Tensor = (batch["motion"] - self.mean) / self.spread
        return normalised * batch["valid"][..., None]

    def _statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and spread of each coordinate over what the sampler draws."""
        rng = np.random.default_rng(_VALIDATION_SEED)
        drawn = [self.corpus.landmarks(self.sampler.draw(rng)) for _ in range(600)]
        frames = np.concatenate([m[rng.integers(0, len(m), 100)] for m in drawn])
        frames = frames.reshape(len(frames), -1)
        spread = frames.std(axis=0)
        spread = np.maximum(spread, _SPREAD_FLOOR * spread.mean()).clip(1e-6)
        return torch.from_numpy(frames.mean(axis=0)).float(), torch.from_numpy(spread).float()

    def _landmark_weights(self) -> Tensor | None:
        if self.options.lip_weight == self.options.eye_weight == 1.0:
            return None
        weights = torch.ones(NUM_LANDMARKS)
        weights[list(LIPS)] = self.options.lip_weight
        weights[list(EYES)] = self.options.eye_weight
        return (weights / weights.mean()).to(self.device)

    def _gap(self, motion: Tensor) -> Tensor:
        metres = (motion * self.spread + self.mean).unflatten(-1, (NUM_LANDMARKS, 3))
        return metres[..., UPPER_INNER_LIP, 1] - metres[..., LOWER_INNER_LIP, 1]


def _audible(sequences: list[MotionSequence]) -> list[MotionSequence]:
    """Sequences with sound, and those whose silence is meant."""
    return [s for s in sequences if s.audio is not None or s.source == "rest"]


def _speech_encoder(options: AtsTaskOptions, out: Path) -> Path:
    if options.speech_encoder:
        return Path(options.speech_encoder)
    trained = out / "speech"
    if (trained / "config.json").is_file():
        return trained
    if options.init:
        beside = initial_weights(options.init, "ats").parent / "speech"
        if (beside / "config.json").is_file():
            return beside
    return PRETRAINED / "open-small" / "speech"
