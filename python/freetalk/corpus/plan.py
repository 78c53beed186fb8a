"""What a corpus holds: the list of sequences for a size and seed, with every split decided here.

``DISJOINT`` says of each source what its test sequences share with no other split: synthetic speech has other
voices and other sentences, acted speech other speakers who say the same ten sentences, captured speech another
take of the same speaker. Faces and meshings are split as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from freetalk.corpus import emotion, running, speech
from freetalk.corpus.assets import (
    SPEAKERS,
    TEST_TAKES,
    TRAIN_TAKES,
    load_clips,
    load_expression_take,
    load_take,
)
from freetalk.corpus.sequences import FPS, SAMPLES_PER_FRAME, Job
from freetalk.corpus.text import sentences

NEUTRAL_SHARE = 0.35
MAX_SECONDS = 8.0


@dataclass(frozen=True)
class Size:
    """How much of each source (sequences a split: train, val, test)."""

    synthetic: tuple[int, int, int]
    facegood_variants: int
    facegood_limit: int | None
    emodb_variants: int
    emodb_limit: int | None
    rom_captured: int | None
    rom_combined: tuple[int, int, int]
    rest: tuple[int, int, int]
    running: tuple[int, int, int]
    identities: tuple[int, int, int]


SIZES = {
    "tiny": Size((7, 2, 3), 1, 1, 1, 1, 1, (1, 1, 1), (1, 1, 1), (1, 1, 0), (6, 2, 2)),
    "small": Size(
        (1000, 50, 80), 2, None, 2, None, None, (52, 4, 4), (32, 2, 4), (400, 8, 0), (80, 8, 12)
    ),
    "full": Size(
        (4000, 150, 240),
        5,
        None,
        4,
        None,
        None,
        (200, 12, 12),
        (80, 6, 8),
        (1200, 16, 0),
        (200, 16, 24),
    ),
}
SPLITS = ("train", "val", "test")
CAPTURED_SPEAKER = "facegood"
"""The one speaker of all captured takes."""
DISJOINT: dict[str, tuple[str, ...]] = {
    "synthetic": ("voice", "sentence", "take"),
    "emodb": ("voice", "take"),
    "facegood": ("take",),
    "running": (),
    "rom": (),
    "rest": (),
}
"""What test sequences of a source share with no other split; what is not listed, they share (or have none of)."""


def draw_emotion(
    rng: np.random.Generator, neutral_share: float = NEUTRAL_SHARE
) -> tuple[str, float]:
    """A label and level: neutral with its share, else uniform over labels and levels."""
    if rng.random() < neutral_share:
        return "neutral", 1.0
    return str(rng.choice(emotion.EMOTIONS[1:])), float(rng.integers(1, 4))


def draw_voice(rng: np.random.Generator, split: str, label: str, intensity: float) -> speech.Voice:
    """A voice of the split, its rate and pitch coloured by the emotion."""
    rate, pitch = emotion.PROSODY.get(label, (1.0, 1.0))
    share = emotion.level(intensity)
    rate = (1 + share * (rate - 1)) * rng.uniform(0.82, 1.18)
    pitch = (1 + share * (pitch - 1)) * rng.uniform(0.6, 1.4)
    flite = {"train": tuple(v for v in speech.FLITE_VOICES if v not in speech.TEST_FLITE), "val": (),
             "test": speech.TEST_FLITE}[split]  # fmt: skip
    variants = {
        "train": speech.ESPEAK_VARIANTS,
        "val": speech.VAL_VARIANTS,
        "test": speech.TEST_VARIANTS,
    }
    if flite and rng.random() < 0.35:
        return speech.Voice("flite", str(rng.choice(flite)), rate, pitch)
    name = f"{rng.choice(speech.ESPEAK_BASES)}+{rng.choice(variants[split])}"
    return speech.Voice("espeak", name, rate, pitch)


def synthetic_jobs(size: Size, seed: int) -> Iterator[Job]:
    """English speech of synthetic voices, one or two sentences a sequence."""
    rng = np.random.default_rng([seed, 1])
    pool = sentences({s: 2 * n for s, n in zip(SPLITS, size.synthetic, strict=True)}, seed)
    for split, count in zip(SPLITS, size.synthetic, strict=True):
        remaining = list(pool[split])
        for i in range(count):
            text = remaining.pop()
            if len(text) < 45 and rng.random() < 0.75:
                text += " " + remaining.pop()
            label, intensity = draw_emotion(rng)
            name = f"synthetic_{split}_{i:05d}"
            yield Job(
                name, split, "synthetic", (seed, 1, SPLITS.index(split), i), emotion=label, intensity=intensity,
                voice=draw_voice(rng, split, label, intensity), text=text, audio=f"audio/{name}.flac",
            )  # fmt: skip


def cut_at_pauses(take: str, start: int, stop: int) -> list[tuple[int, int]]:
    """Cuts frames [start, stop) of a take into pieces of 4 to 8 s at their quietest moments."""
    audio = load_take(take).audio
    edges = (np.arange(stop + 1) * SAMPLES_PER_FRAME).astype(int)
    energy = np.array(
        [np.square(audio[a:b]).mean() for a, b in zip(edges[:-1], edges[1:], strict=True)]
    )
    energy = np.convolve(energy, np.full(5, 0.2), mode="same")
    longest, shortest = int(MAX_SECONDS * FPS), int(4 * FPS)
    pieces = []
    while stop - start > longest:
        latest = min(start + longest, stop - shortest)
        cut = start + shortest + int(energy[start + shortest : latest + 1].argmin())
        pieces.append((start, cut))
        start = cut
    return [*pieces, (start, stop)]


def take_spans() -> Iterator[tuple[str, str, int, int]]:
    """(take, split, first frame, last frame) of the captured takes; the end of one is for validation."""
    for take in TRAIN_TAKES + TEST_TAKES:
        frames = len(load_take(take).curves)
        held = int(0.85 * frames) if take == TRAIN_TAKES[-1] else frames
        yield take, take_split(take), 0, held
        if held < frames:
            yield take, "val", held, frames


def facegood_jobs(size: Size, seed: int) -> Iterator[Job]:
    """Captured takes: every piece as captured and with emotions laid over it, sharing one audio file."""
    rng = np.random.default_rng([seed, 2])
    for take, split, start, stop in take_spans():
        number = (TRAIN_TAKES + TEST_TAKES).index(take)
        pieces = cut_at_pauses(take, start, stop)[: size.facegood_limit]
        for i, (first, last) in enumerate(pieces):
            audio = f"audio/facegood_{take}_{split}_{i:03d}.flac"
            for variant in range(1 + size.facegood_variants):
                label, intensity = draw_emotion(rng, 0.0) if variant else ("neutral", 1.0)
                yield Job(
                    f"facegood_{take}_{split}_{i:03d}_{variant}", split, "facegood",
                    (seed, 2, number, first, variant), take=take, start_frame=first, num_frames=last - first,
                    emotion=label, intensity=intensity, audio=audio, writes_audio=variant == 0,
                )  # fmt: skip


def running_jobs(size: Size, seed: int) -> Iterator[Job]:
    """Running speech joined from the voiced parts of the captured takes of the same split."""
    voiced: dict[str, list[tuple[str, int, int]]] = {}
    for name, split, start, stop in take_spans():
        pieces = cut_at_pauses(name, start, stop)[: size.facegood_limit]
        spans = running.voiced_spans(load_take(name), pieces, SAMPLES_PER_FRAME)
        voiced.setdefault(split, []).extend((name, first, last) for first, last in spans)
    for which, (split, count) in enumerate(zip(SPLITS, size.running, strict=True)):
        for i in range(count):
            rng = np.random.default_rng([seed, 7, which, i])
            label, intensity = draw_emotion(rng, 0.5)
            frames = int(rng.uniform(4.0, MAX_SECONDS) * FPS)
            name = f"running_{split}_{i:04d}"
            yield Job(
                name, split, "running", (seed, 7, which, i), num_frames=frames, emotion=label,
                intensity=intensity, parts=running.draw_parts(rng, voiced[split], frames),
                audio=f"audio/{name}.flac",
            )  # fmt: skip


EMODB_EMOTIONS = {
    "anger": "angry", "boredom": "neutral", "disgust": "disgust", "fear": "afraid", "happiness": "happy", "neutral": "neutral",
    "sadness": "sad",
}  # fmt: skip
"""Acted emotion -> label; boredom has none and counts as neutral."""


def emodb_jobs(size: Size, seed: int) -> Iterator[Job]:
    """Acted emotional speech, two to four clips of a speaker and emotion a sequence.

    The first variant shows the emotion that is heard, at level 2 or 3; the others lay another one over the same voice.
    """
    for which, split in enumerate(SPLITS):
        groups: dict[tuple[str, str], list[str]] = {}
        for clip in load_clips():
            if clip.speaker in SPEAKERS[split]:
                groups.setdefault((clip.speaker, clip.emotion), []).append(clip.name)
        for number, ((speaker, acted), names) in enumerate(
            sorted(groups.items())[: size.emodb_limit]
        ):
            for variant in range(size.emodb_variants):
                rng = np.random.default_rng([seed, 6, which, number, variant])
                order = [str(name) for name in rng.permutation(names)]
                for first in range(0, len(order), 3):
                    label, intensity = EMODB_EMOTIONS[acted], float(rng.integers(2, 4))
                    if variant:
                        label, intensity = draw_emotion(rng)
                    name = f"emodb_{split}_{number:03d}_{variant}_{first}"
                    yield Job(
                        name, split, "emodb", (seed, 6, which, number, variant, first),
                        emotion=label, intensity=1.0 if label == "neutral" else intensity,
                        clips=tuple(order[first : first + 3]), speaker=speaker, audio=f"audio/{name}.flac",
                    )  # fmt: skip


def take_split(take: str) -> str:
    """Split of the leading part of a captured take."""
    return "test" if take in TEST_TAKES else "train"


def rom_jobs(size: Size, seed: int) -> Iterator[Job]:
    """Expressions without audio: the captured take (also mirrored) and random combinations."""
    frames = len(load_expression_take()[0])
    piece = int(MAX_SECONDS * FPS)
    starts = list(range(0, frames - 60, piece))
    for i, start in enumerate(starts[: size.rom_captured]):
        split = "train" if start < 0.8 * frames else ("val" if start < 0.88 * frames else "test")
        for kind in ("captured", "mirrored") if split == "train" else ("captured",):
            yield Job(
                f"rom_{kind}_{i:03d}", split, "rom", (seed, 3, i, len(kind)), take=f"rom_{kind}",
                start_frame=start, num_frames=min(piece, frames - start),
            )  # fmt: skip
    for which, (split, count) in enumerate(zip(SPLITS, size.rom_combined, strict=True)):
        for i in range(count):
            yield Job(
                f"rom_combined_{split}_{i:03d}", split, "rom", (seed, 4, which, i), num_frames=piece
            )


def rest_jobs(size: Size, seed: int) -> Iterator[Job]:
    """Silence and low noise: a resting face that breathes and blinks, with and without emotion."""
    rng = np.random.default_rng([seed, 5])
    for which, (split, count) in enumerate(zip(SPLITS, size.rest, strict=True)):
        for i in range(count):
            label, intensity = draw_emotion(rng)
            name = f"rest_{split}_{i:03d}"
            yield Job(
                name, split, "rest", (seed, 5, which, i), num_frames=int(rng.uniform(4.0, 8.0) * FPS),
                emotion=label, intensity=intensity, audio=f"audio/{name}.flac",
            )  # fmt: skip


def all_jobs(size: Size, seed: int) -> list[Job]:
    """Every sequence of a corpus, in the order of its arrays."""
    jobs = [
        job
        for make in (synthetic_jobs, facegood_jobs, emodb_jobs, rom_jobs, rest_jobs, running_jobs)
        for job in make(size, seed)
    ]
    for source, fields in DISJOINT.items():
        for field in fields:
            both = shared_with_test(jobs, source, field)
            if both:
                raise RuntimeError(f"{source}: the {field} {sorted(both)[0]} is in test and beyond")
    return jobs


def shared_with_test(jobs: list[Job], source: str, field: str) -> set[str]:
    """Voices, sentences or takes that the test sequences of a source have in common with any other split.

    Args:
        jobs: of a corpus.
        source: of the test sequences; those of other splits are of any source.
        field: ``voice``, ``sentence`` or ``take``.
    """
    heard: set[str] = set().union(
        *(_heard(j, field) for j in jobs if j.split == "test" and j.source == source)
    )
    known: set[str] = set().union(*(_heard(j, field) for j in jobs if j.split != "test"))
    return heard & known


def _heard(job: Job, field: str) -> set[str]:
    """What of a kind a sequence holds."""
    spoken = {clip.name: clip.text for clip in load_clips()} if job.clips else {}
    captured = job.source == "facegood" or any(part.take for part in job.parts)
    if field == "voice":
        # The variant is what sounds; the same one speaks several dialects.
        own = job.voice.name.split("+")[-1] if job.voice else job.speaker
        return {CAPTURED_SPEAKER} if captured else {own} if own else set()
    if field == "sentence":
        return {job.text} if job.text else {spoken[name] for name in job.clips}
    takes = {job.take, *job.clips, *(part.take for part in job.parts)}
    return {take for take in takes if take}
