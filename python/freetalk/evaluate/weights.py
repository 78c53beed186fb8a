"""Scores of a folder of weights on the test split of a dataset, as far as the dataset has what they need.

Landmarks to mesh: mean vertex error divided by that of a face that stays still, on faces that training never saw.
Speech to landmarks: correlation of the inner-lip opening with the recorded one and with the audio's energy; lips
closed at p, b, m where phones are known. Affect: what a nearest-centroid classifier, fitted to the train split's
recorded motion, reads from generated faces; motion at intensity 3 against 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from freetalk.audio import load_audio
from freetalk.data import Dataset, MotionSequence, lip_opening
from freetalk.data.landmarks import UPPER_FACE
from freetalk.evaluate.facetalk import SpeechToCodes
from freetalk.evaluate.pretrained import LandmarksToMesh, SpeechToMotion
from freetalk.evaluate.speech_motion import (
    NearestCentroid,
    affect_features,
    closures,
    correlation,
    log_energy,
)
from freetalk.evaluate.writers import plain_table

FloatArray = npt.NDArray[np.float32]
Scores = dict[str, Any]
PARTS = ("stm", "ats", "emotions")
#: Those that only some weights hold.
MORE_PARTS = ("facetalk",)
#: The open corpus's held-out take of captured speech.
CAPTURED_TAKE = "1114_3_15"
_MOST_CLIPS = 40


def evaluate_stm(
    dataset: Dataset,
    model: LandmarksToMesh,
    identities_per_topology: int = 2,
    windows_per_source: int = 3,
    frames: int = 16,
) -> Scores:
    """Relative mean vertex error on unseen faces, true landmarks given; the recorded face, or faces in turn."""
    rows: dict[str, Scores] = {}
    totals = np.zeros(4)
    test = [s for s in dataset.sequences("test") if s.num_frames >= frames and s.source != "rest"]
    for topology, identity in _faces(dataset, identities_per_topology):
        movable = [s for s in test if s.topology in (None, topology)]
        movable = [s for s in movable if s.topology is None or s.identity == identity]
        face = dataset.mesh(identity, topology)
        sums, count = np.zeros(4), 0
        windows = _windows(movable, np.random.default_rng(0), windows_per_source, frames)
        for sequence, start in tqdm(windows, desc=f"stm {topology}/{identity}", leave=False):
            landmarks = dataset.landmarks(sequence, start, start + frames)
            guess = model.vertices(dataset, identity, topology, landmarks).numpy()
            true = dataset.vertex_displacements(topology, sequence, start, start + frames)
            error = np.linalg.norm(guess - true, axis=-1)
            motion = np.linalg.norm(true, axis=-1)
            lips = face.lip_mask if face.lip_mask.any() else np.ones(len(face.vertices), bool)
            sums += [error.mean(), motion.mean(), error[:, lips].mean(), motion[:, lips].mean()]
            count += 1
        row = rows.setdefault(topology, {"sums": np.zeros(4), "windows": 0})
        row["sums"], row["windows"] = row["sums"] + sums, row["windows"] + count
        totals += sums
    if not totals[1] > 0:
        raise ValueError(
            f"{dataset.name} has no test sequence of {frames} frames that moves a face"
        )
    return {
        "relative_error": float(totals[0] / totals[1]),
        "relative_lip_error": float(totals[2] / totals[3]),
        "topologies": {
            topology: {
                "relative_error": float(row["sums"][0] / row["sums"][1]),
                "relative_lip_error": float(row["sums"][2] / row["sums"][3]),
                "mean_error_mm": float(1000 * row["sums"][0] / row["windows"]),
            }
            for topology, row in rows.items()
            if row["windows"]
        },
    }


def _faces(dataset: Dataset, per_topology: int) -> Iterator[tuple[str, int]]:
    """Test faces: those that test sequences were recorded on, or `per_topology` identities a meshing in turn."""
    recorded = {(s.topology, s.identity) for s in dataset.sequences("test") if s.topology}
    if recorded:
        yield from sorted((str(topology), identity) for topology, identity in recorded)
        return
    identities = dataset.identities("test")
    for column, topology in enumerate(dataset.topologies("test")):
        for turn in range(per_topology):
            yield topology, identities[(column * per_topology + turn) % len(identities)]


def evaluate_opening(
    dataset: Dataset, model: SpeechToMotion | SpeechToCodes, take: str | None, samples: int = 5
) -> Scores:
    """Correlation of generated and recorded inner-lip opening over held-out speech.

    Args:
        dataset: with a test split.
        model: what speaks.
        take: of the test split; ``None``: ``CAPTURED_TAKE`` where it is there, else all clips with sound.
        samples: performances.

    Raises:
        ValueError: no test sequence has sound, or none of the take.
    """
    heard = [s for s in dataset.sequences("test") if s.has_sound]
    chosen = [s for s in heard if s.take == (take or CAPTURED_TAKE) and s.emotion == 0]
    if not chosen and take is not None:
        raise ValueError(f"{dataset.name} has no neutral test sequence of take {take!r}")
    chosen = chosen or heard[:_MOST_CLIPS]
    if not chosen:
        raise ValueError(f"{dataset.name} has no test sequence with sound")
    seeds = [list(range(samples))] * len(chosen)
    true: list[FloatArray] = []
    guesses: list[FloatArray] = []
    spoken = model.perform(dataset, chosen, seeds)
    for sequence, motions in tqdm(spoken, desc="opening", total=len(chosen), leave=False):
        recorded = lip_opening(dataset.landmarks(sequence))
        length = min(len(recorded), motions.shape[1])
        true.append(recorded[:length])
        guesses.append(np.stack([lip_opening(motion)[:length] for motion in motions]))
    recorded = np.concatenate(true)
    series = np.concatenate(guesses, axis=1)
    singles = [correlation(one, recorded) for one in series]
    return {
        "frames": len(recorded),
        "single_sample": float(np.mean(singles)),
        "single_sample_lowest": float(np.min(singles)),
        f"mean_of_{samples}": correlation(series.mean(axis=0), recorded),
        "recorded_spread_mm": float(1000 * recorded.std()),
        "generated_spread_mm": float(1000 * series.std(axis=1).mean()),
    }


def evaluate_energy(model: SpeechToMotion, path: Path, samples: int = 3) -> Scores:
    """Correlation of the generated opening with the audio's log energy on any recording."""
    audio = load_audio(str(path))
    wave = np.array(audio.samples, dtype=np.float32)
    features = model.features(wave)
    energy = log_energy(wave, len(features), model.fps, 16000)
    values = [
        correlation(lip_opening(model.motion(features, "neutral", 1.0, seed)), energy)
        for seed in range(samples)
    ]
    return {"correlation": float(np.mean(values)), "lowest": float(np.min(values))}


def evaluate_closures(dataset: Dataset, model: SpeechToMotion | SpeechToCodes) -> Scores | None:
    """Share of p, b, m at which the lips close, generated and recorded; ``None`` where no phones are known."""
    chosen = [s for s in _speech(dataset) if dataset.phones(s)][:_MOST_CLIPS]
    if not chosen:
        return None
    generated: list[bool] = []
    recorded: list[bool] = []
    correlations: list[float] = []
    spoken = model.perform(dataset, chosen, [[seed] for seed in range(len(chosen))])
    for sequence, motions in tqdm(spoken, desc="closures", total=len(chosen), leave=False):
        phones, motion = dataset.phones(sequence), motions[0]
        true = dataset.landmarks(sequence)
        generated += closures(motion, phones, sequence.fps)
        recorded += closures(true, phones, sequence.fps)
        length = min(len(motion), len(true))
        correlations.append(correlation(lip_opening(motion)[:length], lip_opening(true)[:length]))
    return {
        "phones": len(generated),
        "closed": float(np.mean(generated)),
        "closed_in_truth": float(np.mean(recorded)),
        "opening_correlation": float(np.mean(correlations)),
    }


def evaluate_emotions(
    dataset: Dataset, model: SpeechToMotion, clips: int = 3, intensity: float = 2.0
) -> Scores | None:
    """Recognised labels of generated faces, and how much more intensity 3 moves than 1.

    ``None`` where the train split has fewer than two of the weights' emotions, or the test split no speech.
    """
    train = [s for s in dataset.sequences("train") if s.has_sound and s.num_frames > 30]
    strong = [s for s in train if s.emotion == 0 or s.intensity >= 1.5]
    known = {dataset.emotions[s.emotion] for s in strong}
    labels = [emotion for emotion in model.emotions if emotion in known]
    heard = _speech(dataset)[:clips]
    if len(labels) < 2 or not heard:
        return None
    classifier = NearestCentroid(
        np.stack([affect_features(dataset.landmarks(s)) for s in strong]),
        [dataset.emotions[s.emotion] for s in strong],
    )
    hits: dict[str, list[bool]] = {}
    ratios: list[float] = []
    for clip, sequence in enumerate(heard):
        features = model.features(dataset.audio(sequence))
        for number, emotion in enumerate(tqdm(labels, desc=f"emotions {clip + 1}/{len(heard)}")):
            seed = 100 * clip + number
            motion = model.motion(features, emotion, intensity, seed)
            hits.setdefault(emotion, []).append(
                classifier.label(affect_features(motion)) == emotion
            )
            if emotion != "neutral":
                amounts = [
                    _upper_motion(model.motion(features, emotion, level, seed))
                    for level in (3.0, 1.0)
                ]
                ratios.append(amounts[0] / max(amounts[1], 1e-9))
    return {
        "recognised": float(np.mean([hit for own in hits.values() for hit in own])),
        "chance": 1 / len(labels),
        "per_emotion": {emotion: float(np.mean(own)) for emotion, own in hits.items()},
        "centroids": "recorded motion of the train split, intensity of at least 1.5",
        "intensity_3_over_1": float(np.mean(ratios)),
        "intensity_3_moves_more": float(np.mean([ratio > 1 for ratio in ratios])),
    }


def _speech(dataset: Dataset) -> list[MotionSequence]:
    """Test sequences that speak; of the open corpus the English ones, whose phones and emotions are known."""
    heard = [s for s in dataset.sequences("test") if s.has_sound and s.source != "rest"]
    return [s for s in heard if s.source == "synthetic"] or heard


def _upper_motion(landmarks: FloatArray) -> float:
    return float(np.linalg.norm(landmarks[:, list(UPPER_FACE)], axis=-1).mean())


def _windows(
    sequences: Sequence[MotionSequence], rng: np.random.Generator, count: int, frames: int
) -> list[tuple[MotionSequence, int]]:
    """`count` windows of each source."""
    found = []
    for source in sorted({s.source for s in sequences}):
        own = [s for s in sequences if s.source == source]
        for _ in range(count):
            sequence = own[int(rng.integers(len(own)))]
            found.append((sequence, int(rng.integers(sequence.num_frames - frames + 1))))
    return found


def _flat(scores: Scores, prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in scores.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            shown = f"{value:.4f}" if isinstance(value, float) else str(value)
            yield f"{prefix}{name}", shown


def measure(
    dataset: Dataset,
    pretrained: Path,
    *,
    parts: Sequence[str] = PARTS,
    take: str | None = None,
    audio: Sequence[Path] = (),
    samples: int = 5,
    steps: int | None = None,
    device: str | None = None,
) -> Scores:
    """Scores of a folder of weights.

    Args:
        dataset: whose test split is measured on.
        pretrained: the folder.
        parts: of ``PARTS`` and ``MORE_PARTS``; what the dataset does not allow (phones, several emotions) is left out.
        take: held-out take, see :func:`evaluate_opening`.
        audio: further recordings, without motion.
        samples: performances of the take.
        steps: denoising steps; by default those of the weights.
        device: where it runs; ``None``: a GPU where there is one.

    Raises:
        ValueError: an unknown part, or the dataset has no such take, or no test split.
    """
    unknown = set(parts) - {*PARTS, *MORE_PARTS}
    if unknown:
        known = ", ".join((*PARTS, *MORE_PARTS))
        raise ValueError(f"unknown part {sorted(unknown)[0]!r}; known: {known}")
    scores: Scores = {}
    if "stm" in parts:
        scores["stm"] = evaluate_stm(dataset, LandmarksToMesh(pretrained / "stm", device))
    if {"ats", "emotions"} & set(parts):
        sampling = {} if steps is None else {"num_steps": steps}
        model = SpeechToMotion.of(pretrained, sampling, device)
        if "ats" in parts:
            scores["opening"] = evaluate_opening(dataset, model, take, samples)
            scores["closures"] = evaluate_closures(dataset, model)
            for path in audio:
                scores[f"energy {path.name}"] = evaluate_energy(model, path)
        if "emotions" in parts:
            scores["emotions"] = evaluate_emotions(dataset, model)
    if "facetalk" in parts:
        chosen = {} if steps is None else {"sampler": "ddim", "num_steps": steps}
        speaker = SpeechToCodes.of(pretrained, chosen, device)
        scores["facetalk opening"] = evaluate_opening(dataset, speaker, take, samples)
        scores["facetalk closures"] = evaluate_closures(dataset, speaker)
    return {name: found for name, found in scores.items() if found is not None}


def table(scores: Scores) -> str:
    """The scores as two columns of text."""
    return plain_table([("score", "value"), *_flat(scores)])
