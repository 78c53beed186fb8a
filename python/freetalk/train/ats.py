"""Training of the audio-to-landmarks denoiser [FreeTalk 3.1, 3.3, supp. 2]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freetalk.ats import Ats, AtsOptions, GenerateOptions, generate
from freetalk.data import (
    NUM_LANDMARKS,
    Dataset,
    MotionSequence,
    interpolate_frames,
    lip_opening,
)
from freetalk.data.landmarks import (
    INNER_LIP_PAIRS,
    LOWER_INNER_LIP,
    UPPER_FACE,
    UPPER_INNER_LIP,
)
from freetalk.diffusion import Schedule, ScheduleOptions
from freetalk.train.assemble import encoder_record
from freetalk.train.ats_inputs import audible, frame_rate, speech_encoder
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
)
from freetalk.train.mosaic import FloatArray, Mosaics, blended
from freetalk.train.previews import MeanFace, Sample
from freetalk.train.sequences import Epochs, SequenceSampler, numpy_generator, present_weights
from freetalk.train.task_options import AtsTaskOptions

_VALIDATION_SEED = 30
# Frames and denoising steps of a sample to look at.
_SAMPLE_FRAMES, _SAMPLE_STEPS = 90, 25
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
        self.mosaics = Mosaics(self.sampler.sequences, shares)
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
        self.model_options.trained_frames = self._longest_window()
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
            window = self._window(sequence, rng, start)
        else:
            window = self._window(self.sampler.draw(rng), rng)
        if rng.random() < self.options.blend:
            window = blended(window, self._window(self.sampler.draw(rng), rng), rng)
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
        batch = self._stack(items)
        noise = torch.zeros_like(batch["motion"])
        for row, item in enumerate(items):
            noise[row, : len(item["noise"])] = torch.from_numpy(item["noise"])
        for name in ("drop_audio", "drop_affect", "rehearsed", "step", "first_position"):
            batch[name] = torch.tensor([item[name] for item in items])
        wanted = _gap(batch["motion"])
        closed = closures(wanted, batch["valid"], self._usual_opening).sum()
        counts = torch.cat([motion_counts(batch["valid"]), closed[None].float()])
        return {**batch, "noise": noise, "counts": counts}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 at the diffusion step drawn for each window."""
        return self._terms(batch, batch["step"], batch["noise"])

    def validate(self) -> dict[str, float]:
        """Loss at fixed steps and noise, and the opening's correlation when starting from noise."""
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
                    _gap(guess * self.spread + self.mean)[valid].cpu().numpy(),
                    _gap(batch["motion"])[valid].cpu().numpy(),
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
            "training": {
                **training,
                "data": self.corpus.describe(),
                "speech_encoder": self._encoder,
            },
        }
        export_model(directory, config, dict(self.model.state_dict()), keep_float32="motion_")

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
            first_position=batch.get("first_position"),
        )
        return guess.float()

    def _window(
        self,
        sequence: MotionSequence,
        rng: np.random.Generator,
        first: int | None = None,
        altered: bool = True,
    ) -> dict[str, Any]:
        """A window that begins at frame `first` of a sequence, or at a drawn one."""

        def piece(
            source: MotionSequence, frames: int, given: int | None = None
        ) -> tuple[FloatArray, FloatArray]:
            copies = self.features.copies(source)
            copy = copies[int(rng.integers(len(copies)))] if altered else copies[0]
            latest = max(0, copy.num_frames - frames)
            drawn = int(rng.integers(0, latest + 1))
            start = drawn if given is None else min(round(given / copy.speed), latest)
            audio = self.features.features(copy, start, start + frames)
            at = (start + np.arange(len(audio))) * copy.speed
            low, stop = int(at[0]), int(at[-1]) + 2
            return audio, interpolate_frames(self.corpus.landmarks(source, low, stop), at - low)

        length = self.model_options.max_frames
        if altered and rng.random() < self.options.mosaic:
            audio, motion = self.mosaics.window(sequence, length, piece, rng)
        else:
            audio, motion = piece(sequence, length, first)
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

    def _longest_window(self) -> int:
        """Frames of the longest window that the network is shown."""
        longest = max(
            copy.num_frames for s in self.sampler.sequences for copy in self.features.copies(s)
        )
        most = self.model_options.max_frames
        return most if self.options.mosaic > 0 else min(most, longest)

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
