"""Training of FaceTalk's denoiser: speech to expression weights, or to codes of a parametric head [FaceTalk Sec. 4]."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from freetalk.ats import MOTION_DIM
from freetalk.data import NUM_LANDMARKS, Dataset, DatasetError, MotionSequence, lip_opening
from freetalk.data.landmarks import INNER_LIP_PAIRS, LIPS, LOWER_INNER_LIP, UPPER_INNER_LIP
from freetalk.data.pack import FloatArray
from freetalk.diffusion import Schedule, ScheduleOptions
from freetalk.facetalk import FaceTalk, FaceTalkOptions, GenerateOptions, generate
from freetalk.train.assemble import encoder_record
from freetalk.train.ats_inputs import audible, frame_rate, speech_encoder
from freetalk.train.checkpoint import export_model
from freetalk.train.checks import NO_VALIDATION
from freetalk.train.config import TrainingConfig
from freetalk.train.facetalk_windows import CodeWindows
from freetalk.train.features import FeatureCache
from freetalk.train.losses import closure_error, closures, motion_counts, motion_loss, vertex_errors
from freetalk.train.mosaic import blended
from freetalk.train.previews import MeanFace, Sample, sample_of
from freetalk.train.sequences import Epochs, SequenceSampler, numpy_generator, present_weights
from freetalk.train.task_options import FaceTalkTaskOptions

_VALIDATION_SEED = 30
_VALIDATION_TIMESTEPS = (0.15, 0.5, 0.85, 1.0)
# Frames and denoising steps of a sample to look at.
_SAMPLE_FRAMES, _SAMPLE_STEPS = 72, 25
# Of each clip that validation samples with DPM-Solver++.
_SAMPLED_FRAMES, _SAMPLED_STEPS = 300, 15
#: Smallest spread that a code is divided by, relative to the mean one.
_SPREAD_FLOOR = 0.15
#: Takes and frames of each that statistics and the map to the landmarks are computed of.
_TAKES, _FRAMES = 600, 100


class FaceTalkTask:
    """Windows of codes with their speech features; the denoiser restores them from noise."""

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, FaceTalkTaskOptions)
        self.options = config.task
        self.batch_size = config.loop.batch_size
        self.device = device
        self._out = out
        self._face: MeanFace | None = None
        self._encoder: dict[str, str] = {}
        given = {"fps": FaceTalkOptions().fps, **config.model}
        self.corpus = corpus.at(frame_rate(given, config.task.source_weights, corpus))
        own, rest = _codes_of(self.corpus, self.options.targets)
        hears = str(given.get("condition", "audio")) == "audio"
        train = self._usable("train", hears)
        shares = present_weights((s.source for s in train), self.options.source_weights)
        self.sampler = SequenceSampler(train, shares)
        sources = {s.source for s in self.sampler.sequences}
        held_out = self._usable("val", hears)
        self.held_out = [s for s in held_out if s.source in sources] or held_out
        if not self.held_out:
            raise ValueError(NO_VALIDATION.format(corpus.name, "sequences with sound"))
        features = self._features(given) if hears else None
        fields = {"audio_dim": features.width if features else MOTION_DIM, **own, **given}
        self.model_options = FaceTalkOptions.from_dict(fields)
        self.windows = CodeWindows(self.options, self.corpus, features, rest)
        # The same start, whether the features were cached or not.
        torch.manual_seed(config.loop.seed)
        self.model = FaceTalk(self.model_options).to(device)
        self._statistics = self._measure(rest)
        on_device = {name: value.to(device) for name, value in self._statistics.items()}
        self.model.set_code_statistics(**on_device)
        o = self.model_options
        self.schedule = Schedule(
            ScheduleOptions(
                kind=o.schedule,
                num_steps=o.num_train_steps,
                beta_start=o.beta_start,
                beta_end=o.beta_end,
            )
        )
        self.epochs = Epochs(self.sampler.sequences, self.options.window_frames, config.loop.seed)
        self._in_epochs = config.loop.epochs > 0

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """A window, its noise and its diffusion step."""
        if self._in_epochs:
            sequence, start = self.epochs.window(number)
            window = self.windows.cut(sequence, rng, start)
        else:
            window = self.windows.cut(self.sampler.draw(rng), rng)
        if rng.random() < self.options.blend:
            window = blended(window, self.windows.cut(self.sampler.draw(rng), rng), rng)
        steps = self.model_options.num_train_steps
        step = min(int(steps * rng.random() ** (1 / self.options.step_power)), steps - 1)
        return {
            **window,
            "drop_audio": rng.random() < self.options.audio_dropout,
            "step": step,
            "noise": rng.standard_normal(window["motion"].shape, dtype=np.float32),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Windows padded to the longest; padding has no noise."""
        batch: dict[str, Any] = self.windows.stack(items)
        noise = torch.zeros_like(batch["codes"])
        for row, item in enumerate(items):
            noise[row, : len(item["noise"])] = torch.from_numpy(item["noise"])
        for name in ("drop_audio", "step"):
            batch[name] = torch.tensor([item[name] for item in items])
        own = self._statistics  # on the host, as the batch
        moved = (batch["codes"] - own["rest"]) @ own["landmark_basis"]
        wanted = _gap(moved.unflatten(-1, (NUM_LANDMARKS, 3)))
        closed = closures(wanted, batch["valid"], self._usual_opening).sum()
        counts = torch.cat([motion_counts(batch["valid"]), closed[None].float()])
        return {**batch, "noise": noise, "counts": counts}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 4 at the diffusion step drawn for each window."""
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
            noise = torch.randn(stacked["codes"].shape, generator=generator)
            if number % parts == part:
                records.append((number, self._losses({**stacked, "noise": noise})))
        heard = [s for s in self.held_out if s.has_sound] or self.held_out
        at = np.linspace(0, len(heard) - 1, min(self.options.validation_samples, len(heard)))
        for number, index in enumerate(at.round()):
            if number % parts == part:
                records.append((count + number, self._sampled(heard[int(index)], number)))
        return records

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Loss; LVE, MVE and the opening's correlation of sampled clips, through the map to the landmarks."""
        loss = float(np.mean([value for one in records for value in one.get("losses", [])]))
        found = {"loss": loss, "score": loss}
        sampled = [one for one in records if "sampled" in one]
        if sampled:
            errors = np.array([one["sampled"] for one in sampled])
            means = np.average(errors[:, :2], axis=0, weights=errors[:, 2])
            found["sampled_lve_mm2"], found["sampled_mve_mm"] = map(float, means)
            spoken, true = (
                np.concatenate(side) for side in zip(*(one["openings"] for one in sampled))
            )
            with np.errstate(invalid="ignore"):
                found["sampled_opening_correlation"] = float(np.corrcoef(spoken, true)[0, 1])
        return found

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Weights and options; the statistics of the codes keep full precision."""
        about = {**training, "data": self.corpus.describe(), "speech_encoder": self._encoder}
        config = {
            "format": "freetalk-facetalk",
            "version": 1,
            "options": self.model.options.to_dict(),
            "fps": self.corpus.fps,
            "training": about,
        }
        state = dict(self.model.state_dict())
        export_model(directory, config, state, keep_float32=("code_", "rest_", "landmark_"))

    def sample(self) -> Sample:
        """The mean face speaking the first held-out take with sound, and its true motion."""
        sequence = next((s for s in self.held_out if s.has_sound), self.held_out[0])
        options = GenerateOptions(num_steps=_SAMPLE_STEPS)
        spoken = self._spoken(sequence, _SAMPLE_FRAMES, options, _VALIDATION_SEED)
        if self._face is None:
            self._face = MeanFace(self._out / "stm", self.device)
        return sample_of(self._face, self.corpus, sequence, spoken)

    def _usable(self, split: str, hears: bool) -> list[MotionSequence]:
        found = self.corpus.sequences(split)
        return audible(found) if hears else found

    def _features(self, given: dict[str, Any]) -> FeatureCache:
        encoder = speech_encoder(self.options, self._out)
        self._encoder = encoder_record(encoder)
        resampling = given.get("feature_resampling", FaceTalkOptions().feature_resampling)
        return FeatureCache(
            self.corpus,
            [*self.sampler.sequences, *self.held_out],
            encoder,
            Path(self.options.feature_cache or self._out / "cache"),
            self.options.feature_augmentations,
            self.device,
            resampling=str(resampling),
        )

    def _terms(self, batch: dict[str, Any], step: Tensor, noise: Tensor) -> dict[str, Tensor]:
        o = self.options
        valid, counts = batch["valid"], batch.get("counts")
        target = self.model.normalize(batch["codes"]) * valid[..., None]
        guess = self._estimate(batch, step, self.schedule.q_sample(target, step, noise=noise))
        codes = self.model.denormalize(guess)
        given, wanted = (codes, batch["codes"]) if o.loss_units == "codes" else (guess, target)
        motion = None if counts is None else counts[:3]
        # Each code counts as a point, so that the norm is averaged over all of them.
        terms = motion_loss(
            given[..., None], wanted[..., None], valid, o.lambda_velocity, counts=motion
        )
        del terms["acceleration"]
        moved, true = (self.model.landmarks(one) for one in (codes, batch["codes"]))
        if o.opening_weight > 0:
            gap, true_gap = (_lip_gaps(one) / self._usual_opening for one in (moved, true))
            terms["opening"] = motion_loss(gap, true_gap, valid, counts=motion)["loss"]
            terms["loss"] = terms["loss"] + o.opening_weight * terms["opening"]
        if o.closure_weight > 0:
            terms["closure"] = closure_error(
                _gap(moved),
                _gap(true),
                valid,
                self._usual_opening,
                None if counts is None else counts[3],
            )
            terms["loss"] = terms["loss"] + o.closure_weight * terms["closure"]
        return terms

    def _estimate(self, batch: dict[str, Any], step: Tensor, noisy: Tensor) -> Tensor:
        guess: Tensor = self.model(
            noisy,
            step,
            audio=batch["audio"],
            drop_audio=batch.get("drop_audio"),
            valid=None if self.model_options.align_audio else batch["valid"],
        )
        return guess.float()

    def _losses(self, stacked: dict[str, Tensor]) -> dict[str, Any]:
        """Losses at fixed diffusion steps."""
        batch = {name: value.to(self.device) for name, value in stacked.items()}
        losses = []
        for share in _VALIDATION_TIMESTEPS:
            index = round(share * (self.model_options.num_train_steps - 1))
            step = torch.full((len(batch["noise"]),), index, device=self.device)
            losses.append(float(self._terms(batch, step, batch["noise"])["loss"]))
        return {"losses": losses}

    def _sampled(self, clip: MotionSequence, seed: int) -> dict[str, Any]:
        """Errors and opening of a clip that is spoken from noise, against the recorded motion."""
        options = GenerateOptions(sampler="dpmpp", num_steps=_SAMPLED_STEPS)
        motion = self._spoken(clip, _SAMPLED_FRAMES, options, seed).cpu()
        true = torch.from_numpy(self.corpus.landmarks(clip, 0, len(motion)))
        motion = motion[: len(true)]
        return {
            "sampled": [*vertex_errors(motion, true, LIPS), len(true)],
            "openings": [lip_opening(one.numpy()) for one in (motion, true)],
        }

    def _spoken(self, clip: MotionSequence, frames: int, options: Any, seed: int) -> Tensor:
        """Landmark displacements (T, 68, 3), m, of the codes that are sampled for a clip."""
        heard = torch.from_numpy(self.windows.heard(clip, 0, frames)).to(self.device)
        codes = generate(self.model, heard, options=options, seed=seed)
        return self.model.landmarks(codes)

    def _measure(self, rest: FloatArray) -> dict[str, Tensor]:
        """Mean and spread of each code over what the sampler draws, and what codes do to the landmarks."""
        rng = np.random.default_rng(_VALIDATION_SEED)
        codes, landmarks = [], []
        for _ in range(_TAKES):
            sequence = self.sampler.draw(rng)
            own = self.windows.codes(sequence)
            at = rng.integers(0, len(own), _FRAMES)
            codes.append(own[at])
            landmarks.append(self.corpus.landmarks(sequence)[at].reshape(_FRAMES, -1))
        drawn, points = np.concatenate(codes), np.concatenate(landmarks)
        if not np.isfinite(drawn).all():
            raise DatasetError(f"{self.corpus.name} has codes that are not finite")
        gap = lip_opening(points.reshape(-1, NUM_LANDMARKS, 3))
        self._usual_opening = max(float(np.sqrt(np.square(gap).mean())), 1e-4)
        spread = drawn.std(axis=0)
        spread = np.maximum(spread, _SPREAD_FLOOR * spread.mean()).clip(1e-6)
        found = {
            "mean": drawn.mean(axis=0),
            "scale": spread,
            "rest": rest,
            "landmark_basis": _linear_map(drawn - rest, points),
        }
        return {name: torch.from_numpy(value).float() for name, value in found.items()}


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


def _gap(landmarks: Tensor) -> Tensor:
    """Opening (..., T) of the inner lips in landmarks (..., T, 68, 3)."""
    return landmarks[..., UPPER_INNER_LIP, 1] - landmarks[..., LOWER_INNER_LIP, 1]


def _lip_gaps(landmarks: Tensor) -> Tensor:
    """(..., T, pairs, 3) from the lower to the upper inner lip."""
    upper, lower = INNER_LIP_PAIRS
    return landmarks[..., upper, :] - landmarks[..., lower, :]
