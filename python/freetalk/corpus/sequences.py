"""Making single sequences of the corpus: what is said or shown, by whom, in which emotion."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from freetalk.corpus import curves, emotion, rest, running, speech, visemes
from freetalk.corpus.assets import (
    Array,
    FaceModel,
    Take,
    load_clips,
    load_expression_take,
    load_face_model,
    load_take,
)
from freetalk.corpus.lips import Lips
from freetalk.corpus.phones import Phone, emodb_label, merge

FPS = 30
SAMPLE_RATE_HZ = 16000
SAMPLES_PER_FRAME = SAMPLE_RATE_HZ / FPS
_SILENCE = np.zeros(0, np.float32)


@dataclass(frozen=True)
class Job:
    """One sequence to make."""

    id: str
    split: str
    source: str
    seed: tuple[int, ...]
    take: str = ""
    start_frame: int = 0
    num_frames: int = 0
    emotion: str = "neutral"
    intensity: float = 1.0
    voice: speech.Voice | None = None
    text: str | None = None
    audio: str | None = None
    writes_audio: bool = True
    clips: tuple[str, ...] = ()
    speaker: str | None = None
    parts: tuple[running.Part, ...] = ()


@dataclass(frozen=True)
class Made:
    """A made sequence: weights (T, E), phones of synthetic speech, and its sound, (S,) in [-1, 1].

    The sound is empty where there is none, and where another job of the same sound makes it.
    """

    job: Job
    weights: Array
    audio: Array
    phones: list[Phone] = field(default_factory=list)


def voice_id(job: Job) -> str | None:
    """Name of a sequence's voice in the manifest."""
    if job.voice is not None:
        return f"{job.voice.engine}:{job.voice.name}"
    return f"emodb:{job.speaker}" if job.speaker else None


def loudness_factor(audio: Array, num_frames: int) -> np.ndarray:
    """(T,) factor in [0.75, 1.25] for the jaw: 2 % a decibel about the median level of the voiced frames."""
    edges = (np.arange(num_frames + 1) * SAMPLES_PER_FRAME).astype(int)
    power = np.concatenate([[0.0], np.cumsum(audio.astype(np.float64) ** 2)])
    edges = np.minimum(edges, len(audio))
    mean = np.diff(power[edges]) / np.maximum(np.diff(edges), 1)
    level = 10 * np.log10(mean + 1e-8)
    voiced = level > level.max() - 30
    factor = np.clip(1 + 0.02 * (level - np.median(level[voiced])), 0.75, 1.25)
    return np.convolve(np.pad(factor, 2, mode="edge"), np.full(5, 0.2), mode="valid")


def recorded(audio: Array, rng: np.random.Generator) -> Array:
    """The voice as recorded: random level, a touch of room and of noise."""
    result = audio.astype(np.float64)
    if rng.random() < 0.4:
        delay = int(rng.uniform(0.004, 0.03) * SAMPLE_RATE_HZ)
        result[delay:] += rng.uniform(0.05, 0.25) * audio[:-delay]
    result *= rng.uniform(0.25, 0.85) / max(float(np.abs(result).max()), 1e-4)
    noise = rng.normal(0, 1, len(result))
    if rng.random() < 0.5:
        noise = np.convolve(noise, np.full(4, 0.5), mode="same")
    result += 10 ** (rng.uniform(-75, -48) / 20) * noise
    return np.clip(result, -0.999, 0.999).astype(np.float32)


def fit_audio(audio: Array, num_frames: int) -> Array:
    """Audio cut or padded with silence to exactly the length of the frames."""
    count = int(round(num_frames * SAMPLES_PER_FRAME))
    return np.pad(audio[:count], (0, max(0, count - len(audio)))).astype(np.float32)


class Maker:
    """Makes sequences; holds the face model and the takes already converted."""

    def __init__(self) -> None:
        self.model: FaceModel = load_face_model()
        self.lips = Lips(self.model)
        self._takes: dict[str, tuple[Take, Array]] = {}

    def make(self, job: Job) -> Made:
        """Weights, sound and phones of a job."""
        rng = np.random.default_rng(job.seed)
        makers = {
            "synthetic": self._synthetic,
            "facegood": self._facegood,
            "emodb": self._emodb,
            "rom": self._rom,
            "rest": self._rest,
            "running": self._running,
        }
        made = makers[job.source](job, rng)
        return replace(made, weights=np.clip(made.weights, 0, 1).astype(np.float32))

    def _finish(self, job: Job, weights: Array, rng: np.random.Generator) -> Array:
        """Idle movement, emotion and blinks; the lips' opening stays that of the input."""
        weights = rest.add_idle(self.model, self.lips, weights, rng, FPS, amount=0.8)
        if job.emotion != "neutral":
            weights = emotion.add_emotion(
                self.model, self.lips, weights, job.emotion, job.intensity, rng, FPS
            )
        return rest.add_blinks(self.model, weights, rng, FPS)

    def _synthetic(self, job: Job, rng: np.random.Generator) -> Made:
        if job.voice is None or job.text is None:
            raise ValueError(f"sequence {job.id} has no voice or no text")
        audio, phones = speech.speak(job.text, job.voice)
        return self._spoken(job, audio, phones, rng)

    def _emodb(self, job: Job, rng: np.random.Generator) -> Made:
        """Real emotional clips of one speaker, joined with short pauses, moved by their phone labels."""
        clips = {clip.name: clip for clip in load_clips()}
        pieces: list[Array] = []
        phones: list[Phone] = []
        at = 0.0
        for name in job.clips:
            clip, start = clips[name], 0.0
            length = len(clip.audio) / SAMPLE_RATE_HZ
            for end, label in clip.phones:
                end = min(end, length)
                phones.append(Phone(at + start, at + end, emodb_label(label)))
                start = end
            pause = rng.uniform(0.15, 0.35)
            phones.append(Phone(at + start, at + length + pause, "sil"))
            pieces += [clip.audio, np.zeros(int(pause * SAMPLE_RATE_HZ), np.float32)]
            at += (len(pieces[-2]) + len(pieces[-1])) / SAMPLE_RATE_HZ
        return self._spoken(job, np.concatenate(pieces), merge(phones), rng)

    def _spoken(
        self, job: Job, audio: Array, phones: list[Phone], rng: np.random.Generator
    ) -> Made:
        """Motion of a voice with phone timings; adds a pause before and after."""
        lead, trail = rng.uniform(0.08, 0.45), rng.uniform(0.15, 0.50)
        audio = np.pad(audio, [int(s * SAMPLE_RATE_HZ) for s in (lead, trail)])
        duration = len(audio) / SAMPLE_RATE_HZ
        shifted = [Phone(p.start_s + lead, p.end_s + lead, p.label) for p in phones]
        edges = [Phone(0.0, shifted[0].start_s, "sil")], [Phone(shifted[-1].end_s, duration, "sil")]
        shifted = merge([*edges[0], *shifted, *edges[1]])
        num_frames = int(duration * FPS)
        audio = fit_audio(audio, num_frames)
        style = visemes.SpeakingStyle(
            amplitude=rng.uniform(0.85, 1.30),
            rounding=rng.uniform(0.85, 1.2),
            spreading=rng.uniform(0.8, 1.2),
            asymmetry=rng.normal(0, 0.05),
        )
        loudness = loudness_factor(audio, num_frames)
        weights = visemes.speech_weights(
            self.model, self.lips, shifted, num_frames, loudness, style
        )
        sound = recorded(audio, rng) if job.writes_audio else _SILENCE
        return Made(job, self._finish(job, weights, rng), sound, shifted)

    def _take(self, name: str) -> tuple[Take, Array]:
        if name not in self._takes:
            take = load_take(name)
            self._takes[name] = (take, curves.facegood_weights(self.model, self.lips, take))
        return self._takes[name]

    def _facegood(self, job: Job, rng: np.random.Generator) -> Made:
        take, all_weights = self._take(job.take)
        stop = job.start_frame + job.num_frames
        first, last = (int(round(f * SAMPLES_PER_FRAME)) for f in (job.start_frame, stop))
        sound = fit_audio(take.audio[first:last], job.num_frames) if job.writes_audio else _SILENCE
        return Made(job, self._finish(job, all_weights[job.start_frame : stop], rng), sound)

    def _running(self, job: Job, rng: np.random.Generator) -> Made:
        """Voiced parts of captured takes, joined."""
        parts = []
        for part in job.parts:
            take, weights = self._take(part.take or job.parts[0].take)
            first, last = (round(f * SAMPLES_PER_FRAME) for f in (part.start, part.stop))
            parts.append((part, take.audio[first:last], weights[part.start : part.stop]))
        audio, weights = running.joined(parts, rng, SAMPLES_PER_FRAME, SAMPLE_RATE_HZ)
        sound = recorded(fit_audio(audio, job.num_frames), rng)
        return Made(job, self._finish(job, weights[: job.num_frames], rng), sound)

    def _rom(self, job: Job, rng: np.random.Generator) -> Made:
        if job.take:
            values, names, _ = load_expression_take()
            stop = job.start_frame + job.num_frames
            weights = curves.arkit_weights(self.model, values[job.start_frame : stop], names)
            if job.take.endswith("mirrored"):
                weights = curves.mirrored(self.model, weights) * np.float32(rng.uniform(0.7, 1.1))
        else:
            weights = curves.combined_shapes(self.model, job.num_frames, rng, FPS)
        weights = self.lips.without_interpenetration(np.clip(weights, 0, 1))
        return Made(job, weights, _SILENCE)

    def _rest(self, job: Job, rng: np.random.Generator) -> Made:
        weights = rest.rest_weights(self.model, self.lips, job.num_frames, rng, FPS)
        count = int(round(job.num_frames * SAMPLES_PER_FRAME))
        noise = rng.normal(0, 1, count)
        if rng.random() < 0.5:
            noise = np.convolve(noise, np.full(8, 0.35), mode="same")
        silent = rng.random() < 0.25
        audio = np.zeros(count) if silent else noise * 10 ** (rng.uniform(-75, -45) / 20)
        if job.emotion != "neutral":
            weights = emotion.add_emotion(
                self.model, self.lips, weights, job.emotion, job.intensity, rng, FPS
            )
        return Made(job, rest.add_blinks(self.model, weights, rng, FPS), audio.astype(np.float32))
