"""Training of a speech encoder from scratch: supervised by what a face has to know of speech.

No self-supervised weights are needed: the encoder learns to tell phones, spectra, mouth curves and the lip
opening from the sound. The heads are dropped at export.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from freetalk.data import Dataset, MotionSequence
from freetalk.speech import SpeechEncoder, SpeechEncoderOptions, normalize_wave
from freetalk.train.augment import FASTEST_VOICE, augment_wave, change_speed, change_voice
from freetalk.train.checkpoint import NO_VALIDATION, export_model
from freetalk.train.config import TrainingConfig
from freetalk.train.progress import notice
from freetalk.train.sequences import SequenceSampler, present_weights
from freetalk.train.speech_recordings import RECORDED, Recordings
from freetalk.train.speech_targets import IGNORED_PHONE, SpeechTargets, log_mel
from freetalk.train.task_options import SpeechTaskOptions

_VALIDATION_SEED = 20


class SpeechModel(nn.Module):
    """The encoder and its teachers: linear heads, those of motion separate for each source."""

    def __init__(
        self,
        options: SpeechEncoderOptions,
        num_phones: int,
        num_mels: int,
        num_curves: int,
        sources: list[str],
    ) -> None:
        super().__init__()
        width = options.hidden_size
        self.encoder = SpeechEncoder(options)
        self.phones = nn.Linear(width, num_phones)
        self.mels = nn.Linear(width, num_mels)
        self.sources = sources
        self.motion = nn.Linear(width, len(sources) * (1 + num_curves))

    def forward(self, wave: Tensor, source: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Phone logits, log-mels, curves and opening of (B, S) normalised samples.

        `source` (B, S') names the source of each frame, whose head of motion answers.
        """
        hidden = self.encoder(wave)  # (B, S', C)
        motion = self.motion(hidden).unflatten(-1, (len(self.sources), -1))
        own = motion.gather(2, source[..., None, None].expand(-1, -1, 1, motion.shape[-1]))[:, :, 0]
        return self.phones(hidden), self.mels(hidden), own[..., 1:], own[..., 0]


class SpeechTask:
    """Random crops of the train split, altered in sound, with targets at the encoder's frames."""

    epochs = None  # crops begin anywhere

    def __init__(
        self, config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device
    ) -> None:
        assert isinstance(config.task, SpeechTaskOptions)
        self.options = config.task
        self.corpus = corpus
        self.batch_size = config.loop.batch_size
        self.device = device
        self.recordings = Recordings(self.options.recordings, corpus.fps)
        heard = [s for s in corpus.sequences("train") if s.has_sound]
        heard += self.recordings.sequences
        shares = present_weights((s.source for s in heard), self.options.source_weights)
        self.sampler = SequenceSampler(heard, shares)
        self.targets = SpeechTargets(corpus, self.sampler.sequences, self.recordings)
        self.sources = sorted({s.source for s in self.sampler.sequences})
        self.held_out = [
            s for s in corpus.sequences("val") if s.has_sound and s.source in self.sources
        ]
        if not self.held_out:
            raise ValueError(NO_VALIDATION.format(corpus.name, "sequences with sound"))
        named = self.options.motion_sources
        self._taught = [s for s in named if s in self.sources] or self.sources
        if self.targets.num_curves == 0:
            notice(
                f"{corpus.name} has no phones and expression curves: the encoder learns from spectra and "
                "lip opening alone; start it from given weights (task.init=open-small), or add aligned "
                "speech (task.recordings)"
            )
        options = SpeechEncoderOptions.from_dict(config.model)
        self.model: SpeechModel = SpeechModel(
            options,
            len(self.targets.phones),
            self.options.num_mels,
            self.targets.num_curves,
            self.sources,
        ).to(device)
        self._timing = self.model.encoder.timing
        if options.conv_kernel[0] >= 160:
            self._start_from_filters(options.conv_dim[0], options.conv_kernel[0])

    def item(self, rng: np.random.Generator, number: int) -> dict[str, npt.NDArray[Any]]:
        """A crop with its targets."""
        return self._crop(self.sampler.draw(rng), rng)

    def collate(self, items: list[dict[str, npt.NDArray[Any]]]) -> dict[str, Any]:
        """Crops of one length side by side; ``counts`` of frames with a phone, with sound, with motion."""
        batch: dict[str, Any] = {
            key: torch.from_numpy(np.stack([item[key] for item in items]))
            for key in ("phones", "curves", "opening", "valid", "moving", "source")
        }
        wave, clean = (
            normalize_wave(torch.from_numpy(np.stack([item[key] for item in items])))
            for key in ("wave", "clean")
        )
        frames = batch["phones"].shape[1]
        batch["phones"] = batch["phones"].masked_fill(~batch["valid"], IGNORED_PHONE)
        batch["moving"] = batch["moving"] & batch["valid"]
        batch["wave"] = wave
        batch["mels"] = log_mel(clean, frames, self._timing.offset_s, self.options.num_mels)
        counted = (batch["phones"] != IGNORED_PHONE, batch["valid"], batch["moving"])
        batch["counts"] = torch.stack([frame.sum() for frame in counted]).float()
        return batch

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Weighted sum of the four teachers' losses."""
        return self._terms(batch, *self._predict(batch))

    def validate(self, part: int, parts: int) -> list[tuple[int, Any]]:
        """Unaltered crops of the val split, a batch a record."""
        batches = self._validation_batches()
        return [(n, self._judged(batches[n])) for n in range(part, len(batches), parts)]

    def _judged(self, cpu_batch: dict[str, Any]) -> dict[str, Any]:
        """Terms and phone accuracy of a batch, and the openings (guessed, true) of each source."""
        batch = {name: value.to(self.device) for name, value in cpu_batch.items()}
        predictions = self._predict(batch)
        phones, _, _, opening = predictions
        terms = {n: float(value) for n, value in self._terms(batch, *predictions).items()}
        known = batch["phones"] != IGNORED_PHONE
        if bool(known.any()):
            hits = (phones.argmax(-1) == batch["phones"])[known].float().mean()
            terms["phone_accuracy"] = float(hits)
        openings: dict[str, list[Any]] = {}
        for row, source in enumerate(batch["source"][:, 0].tolist()):
            both = torch.stack([opening[row].float(), batch["opening"][row].float()])
            kept = both[:, batch["valid"][row]].cpu().numpy()
            openings.setdefault(self.sources[source], []).append(kept)
        return {"terms": terms, "openings": openings}

    def scores(self, records: list[Any]) -> dict[str, float]:
        """Loss, phone accuracy and, for each source, correlation of the opening."""
        names = dict.fromkeys(name for one in records for name in one["terms"])
        scores = {
            name: float(np.mean([r["terms"][name] for r in records if name in r["terms"]]))
            for name in names
        }
        for source in self.sources:
            parts = [both for one in records for both in one["openings"].get(source, [])]
            guessed, wanted = np.concatenate(parts, axis=1) if parts else np.zeros((2, 1))
            if wanted.std() > 1e-3:  # a resting face has no opening to follow
                both = np.corrcoef(guessed, wanted)
                scores[f"opening_correlation_{source}"] = float(both[0, 1])
        return {**scores, "score": scores["loss"]}

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """The encoder alone, in the layout of Hugging Face."""
        config = {
            "architectures": ["HubertModel"],
            **self.model.encoder.options.to_dict(),
            "training": training,
        }
        export_model(directory, config, dict(self.model.encoder.state_dict()))

    def _predict(self, batch: dict[str, Any]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        return self.model(batch["wave"], batch["source"])

    def _terms(
        self,
        batch: dict[str, Any],
        phones: Tensor,
        mels: Tensor,
        curves: Tensor,
        opening: Tensor,
    ) -> dict[str, Tensor]:
        o = self.options
        labelled, heard, moving = batch["counts"].clamp_min(1).unbind()
        entropy = functional.cross_entropy(
            phones.float().flatten(0, 1),
            batch["phones"].flatten(),
            reduction="sum",
            label_smoothing=0.05,
        )
        wanted = batch["opening"][..., None]
        terms = {
            "phones": entropy / labelled,
            "mels": _square(mels, batch["mels"], batch["valid"]) / heard,
            "curves": _square(curves, batch["curves"], batch["moving"]) / moving,
            "opening": _square(opening[..., None], wanted, batch["moving"]) / moving,
        }
        terms["loss"] = (
            o.phone_weight * terms["phones"]
            + o.mel_weight * terms["mels"]
            + o.curve_weight * terms["curves"]
            + o.opening_weight * terms["opening"]
        )
        return terms

    def _crop(
        self, sequence: MotionSequence, rng: np.random.Generator, altered: bool = True
    ) -> dict[str, Any]:
        """A crop that begins with a piece of `sequence`; altered ones join pieces of several."""
        length = int(self.options.crop_s * self.corpus.sample_rate_hz)
        halves = np.arange(1, int(2 * self.options.crop_s))  # cuts lie at half seconds
        most = min(self.options.pieces, len(halves) + 1)
        count = int(rng.integers(1, most + 1)) if altered else 1
        cuts = np.sort(rng.choice(halves, count - 1, replace=False)) * (length / (len(halves) + 1))
        cuts = cuts.astype(int).tolist()
        frames = self.model.encoder.num_frames(length)
        centres = (self._timing.offset_s + np.arange(frames) / self._timing.rate_hz) * (
            self.corpus.sample_rate_hz
        )
        pieces = []
        for first, stop in zip([0, *cuts], [*cuts, length], strict=True):
            inside = centres[(centres >= first) & (centres < stop)] - first
            pieces.append(self._piece(sequence, stop - first, inside, rng, altered))
            sequence = self.sampler.draw(rng)
        return {key: np.concatenate([piece[key] for piece in pieces]) for key in pieces[0]}

    def _piece(
        self,
        sequence: MotionSequence,
        length: int,
        centres: npt.NDArray[np.floating],
        rng: np.random.Generator,
        altered: bool,
    ) -> dict[str, npt.NDArray[Any]]:
        """`length` samples of a sequence, and the targets at the samples `centres` of it."""
        rate = self.corpus.sample_rate_hz
        reach = self.options.speed_range if altered else 0.0
        revoiced = altered and rng.random() < self.options.voices
        most = FASTEST_VOICE if revoiced else 1.0 + reach
        heard_in = self.recordings if sequence.source == RECORDED else self.corpus
        source = heard_in.audio(sequence)
        needed = int(length * most) + 2
        start = int(rng.integers(0, max(1, len(source) - needed + 1)))
        clean = source[start : start + needed]
        if revoiced:
            clean, speed = change_voice(clean, rng, rate)
        else:
            speed = 1.0 + rng.uniform(-reach, reach)
            clean = change_speed(clean, speed)
        clean = clean[:length]
        heard = len(clean)
        clean = np.pad(clean, (0, length - heard))
        wave = clean
        if altered and rng.random() < self.options.augment:
            gain = np.float32(10 ** (rng.uniform(-9, 6) / 20))
            clean = clean * gain
            wave = augment_wave(clean, rng, rate)
        at_source = (start / rate + centres / rate * speed).astype(np.float32)
        curves, opening = self.targets.motion_at(sequence, at_source)
        moving = sequence.source in self._taught and sequence.source != RECORDED
        return {
            "wave": wave,
            "clean": clean,
            "phones": self.targets.phones_at(sequence, at_source),
            "curves": curves,
            "opening": opening,
            "valid": (centres < heard) & (at_source * sequence.fps < sequence.num_frames),
            "moving": np.full(len(centres), moving),
            "source": np.full(len(centres), self.sources.index(sequence.source)),
        }

    def _validation_batches(self) -> list[dict[str, Any]]:
        rng = np.random.default_rng(_VALIDATION_SEED)
        per_source = max(1, self.options.validation_crops // len(self.sources))
        items = []
        for source in self.sources:
            own = [s for s in self.held_out if s.source == source]
            if own:
                sampler = SequenceSampler(own, {})
                drawn = [sampler.draw(rng) for _ in range(per_source)]
                items += [self._crop(s, rng, altered=False) for s in drawn]
        size = self.batch_size
        return [self.collate(items[i : i + size]) for i in range(0, len(items), size)]

    @torch.no_grad()
    def _start_from_filters(self, channels: int, taps: int) -> None:
        """Lets the first convolution start as a bank of mel-spaced Gabor filters in four phases.

        Training from waves is short here; what a filter bank knows need not be learnt.
        """
        weights = dict(self.model.encoder.named_parameters())
        kernel = weights["feature_extractor.conv_layers.0.conv.weight"]  # (C, 1, taps)
        bank = gabor_bank(channels, taps, self.corpus.sample_rate_hz).to(kernel)
        rng = np.random.default_rng(_VALIDATION_SEED)
        drawn = [self.sampler.draw(rng) for _ in range(16)]
        items = [self._crop(s, rng, altered=False)["wave"] for s in drawn]
        waves = normalize_wave(torch.from_numpy(np.stack(items))).to(kernel)
        response = functional.conv1d(waves[:, None], bank, stride=80)
        level = response.square().mean(dim=(0, 2)).sqrt().clamp_min(1e-4)
        kernel.copy_(bank / level[:, None, None])
        bias = weights.get("feature_extractor.conv_layers.0.conv.bias")
        if bias is not None:  # a floor under the norm, so that silence stays apart from speech
            generator = torch.Generator().manual_seed(_VALIDATION_SEED)
            bias.copy_(0.3 * torch.randn(bias.shape, generator=generator).to(bias))


def gabor_bank(channels: int, taps: int, sample_rate_hz: int) -> Tensor:
    """Windowed sinusoids at mel-spaced frequencies, phases 0, 90, 180, 270 degrees; (C, 1, taps)."""
    bands = max(1, math.ceil(channels / 4))
    mel = torch.linspace(2595 * math.log10(1 + 70 / 700), 2595 * math.log10(1 + 7400 / 700), bands)
    hertz = 700 * (10 ** (mel / 2595) - 1)
    times = (torch.arange(taps) - (taps - 1) / 2) / sample_rate_hz
    width_s = (1.2 / (0.1 * hertz + 60)).clamp_max(taps / sample_rate_hz / 2.5)
    window = torch.exp(-0.5 * (times / (0.5 * width_s[:, None])) ** 2)
    angle = 2 * math.pi * hertz[:, None] * times
    phases = torch.tensor([0.0, 0.5, 1.0, 1.5]) * math.pi
    bank = window[:, None] * torch.cos(angle[:, None] - phases[:, None])  # (bands, 4, taps)
    bank = bank - bank.mean(dim=-1, keepdim=True)
    bank = bank / bank.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    return bank.flatten(0, 1)[:channels, None]


def _square(prediction: Tensor, target: Tensor, counted: Tensor) -> Tensor:
    """Sum over the counted frames of the mean square over channels; 0 without channels."""
    squared = (prediction.float() - target).square().sum(dim=-1) * counted
    return squared.sum() / max(target.shape[-1], 1)
