"""Scores of a folder of weights on the open corpus's test split.

Landmarks to mesh: mean vertex error divided by that of a face that stays still, on identities and meshings that
training never saw. Speech to landmarks: correlation of the inner-lip opening with the recorded one and with the
audio's energy; lips closed at p, b, m. Affect: what a nearest-centroid classifier, fitted to the train split's
recorded motion, reads from generated faces; motion at intensity 3 against 1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from tqdm import tqdm

from freetalk.audio import load_audio
from freetalk.data import MotionSequence, OpenCorpus, lip_opening
from freetalk.data.landmarks import UPPER_FACE
from freetalk.evaluate.pretrained import SpeechToMotion, load_stm
from freetalk.evaluate.speech_motion import (
    NearestCentroid,
    affect_features,
    closures,
    correlation,
    log_energy,
)
from freetalk.evaluate.writers import plain_table
from freetalk.train.stm_meshes import prepare_mesh

FloatArray = npt.NDArray[np.float32]
Scores = dict[str, Any]
PARTS = ("stm", "ats", "emotions")


def evaluate_stm(
    corpus: OpenCorpus,
    pretrained: Path,
    identities_per_topology: int = 2,
    windows_per_source: int = 3,
    frames: int = 16,
) -> Scores:
    """Relative mean vertex error on unseen identities and unseen meshings, true landmarks given."""
    model = load_stm(pretrained)
    rows: dict[str, Scores] = {}
    totals = np.zeros(4)
    rng = np.random.default_rng(0)
    windows = list(_windows(corpus, rng, windows_per_source, frames))
    identities = corpus.identities("test")
    for column, topology in enumerate(corpus.topologies("test")):
        sums = np.zeros(4)
        for turn in range(identities_per_topology):
            identity = identities[(column * identities_per_topology + turn) % len(identities)]
            options = model.options
            mesh = prepare_mesh(corpus, identity, topology, options.length_scale, options.k_eig)
            with torch.no_grad():
                features = model.encode(mesh.positions, mesh.operators)
            for sequence, start in tqdm(windows, desc=f"stm {topology}/{identity}", leave=False):
                landmarks = torch.from_numpy(corpus.landmarks(sequence, start, start + frames))
                with torch.no_grad():
                    guess = model.decode(features, mesh.operators, landmarks).numpy()
                true = corpus.vertex_displacements(topology, sequence, start, start + frames)
                error = np.linalg.norm(guess - true, axis=-1)
                motion = np.linalg.norm(true, axis=-1)
                lips = mesh.lip_mask.numpy()
                sums += [error.mean(), motion.mean(), error[:, lips].mean(), motion[:, lips].mean()]
        rows[topology] = {
            "relative_error": float(sums[0] / sums[1]),
            "relative_lip_error": float(sums[2] / sums[3]),
            "mean_error_mm": float(1000 * sums[0] / (identities_per_topology * len(windows))),
        }
        totals += sums
    return {
        "relative_error": float(totals[0] / totals[1]),
        "relative_lip_error": float(totals[2] / totals[3]),
        "topologies": rows,
    }


def evaluate_opening(
    corpus: OpenCorpus, model: SpeechToMotion, take: str, samples: int = 5
) -> Scores:
    """Correlation of generated and recorded inner-lip opening over a held-out take."""
    chosen = [
        s
        for s in corpus.sequences("test")
        if s.take == take and s.audio is not None and s.emotion == 0
    ]
    if not chosen:
        raise ValueError(f"the corpus has no neutral test sequence of take {take!r}")
    true: list[FloatArray] = []
    guesses: list[list[FloatArray]] = [[] for _ in range(samples)]
    for sequence in tqdm(chosen, desc=f"take {take}"):
        recorded = lip_opening(corpus.landmarks(sequence))
        features = model.features(corpus.audio(sequence))
        length = min(len(recorded), len(features))
        true.append(recorded[:length])
        for seed in range(samples):
            motion = model.motion(features, "neutral", 1.0, seed)
            guesses[seed].append(lip_opening(motion)[:length])
    recorded = np.concatenate(true)
    series = np.stack([np.concatenate(parts) for parts in guesses])
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


def evaluate_closures(corpus: OpenCorpus, model: SpeechToMotion, limit: int = 40) -> Scores:
    """Share of p, b, m at which the lips close, generated and recorded, on unheard voices and texts."""
    chosen = [s for s in corpus.sequences("test", ["synthetic"]) if corpus.phones(s)][:limit]
    if not chosen:
        raise ValueError("the corpus has no synthetic test sequence with phones")
    generated: list[bool] = []
    recorded: list[bool] = []
    correlations: list[float] = []
    for seed, sequence in enumerate(tqdm(chosen, desc="closures")):
        phones = corpus.phones(sequence)
        emotion = corpus.emotions[sequence.emotion]
        features = model.features(corpus.audio(sequence))
        motion = model.motion(features, emotion, sequence.intensity, seed)
        true = corpus.landmarks(sequence)
        generated += closures(motion, phones, model.fps)
        recorded += closures(true, phones, model.fps)
        length = min(len(motion), len(true))
        correlations.append(correlation(lip_opening(motion)[:length], lip_opening(true)[:length]))
    return {
        "phones": len(generated),
        "closed": float(np.mean(generated)),
        "closed_in_corpus": float(np.mean(recorded)),
        "opening_correlation": float(np.mean(correlations)),
    }


def evaluate_emotions(
    corpus: OpenCorpus, model: SpeechToMotion, clips: int = 3, intensity: float = 2.0
) -> Scores:
    """Recognised labels of generated faces, and how much more intensity 3 moves than 1."""
    train = [s for s in corpus.sequences("train") if s.audio is not None and s.num_frames > 30]
    strong = [s for s in train if s.emotion == 0 or s.intensity >= 1.5]
    classifier = NearestCentroid(
        np.stack([affect_features(corpus.landmarks(s)) for s in strong]),
        [corpus.emotions[s.emotion] for s in strong],
    )
    heard = corpus.sequences("test", ["synthetic"])[:clips]
    labels = [e for e in model.emotions if e in classifier.classes]
    hits: dict[str, list[bool]] = {}
    ratios: list[float] = []
    for clip, sequence in enumerate(heard):
        features = model.features(corpus.audio(sequence))
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


def _upper_motion(landmarks: FloatArray) -> float:
    return float(np.linalg.norm(landmarks[:, list(UPPER_FACE)], axis=-1).mean())


def _windows(
    corpus: OpenCorpus, rng: np.random.Generator, count: int, frames: int
) -> Iterator[tuple[MotionSequence, int]]:
    """`count` windows of each source of the test split."""
    test = [s for s in corpus.sequences("test") if s.num_frames >= frames and s.source != "rest"]
    for source in sorted({s.source for s in test}):
        own = [s for s in test if s.source == source]
        for _ in range(count):
            sequence = own[int(rng.integers(len(own)))]
            yield sequence, int(rng.integers(sequence.num_frames - frames + 1))


def _flat(scores: Scores, prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, value in scores.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            shown = f"{value:.4f}" if isinstance(value, float) else str(value)
            yield f"{prefix}{name}", shown


def measure(
    corpus: OpenCorpus,
    pretrained: Path,
    *,
    parts: Sequence[str] = PARTS,
    take: str = "1114_3_15",
    audio: Sequence[Path] = (),
    samples: int = 5,
    steps: int | None = None,
) -> Scores:
    """Scores of a folder of weights.

    Args:
        corpus: whose test split is measured on.
        pretrained: the folder.
        parts: of ``PARTS``.
        take: held-out take of recorded speech.
        audio: further recordings, without motion.
        samples: performances of the take.
        steps: denoising steps; by default those of the weights.

    Raises:
        ValueError: an unknown part, or the corpus has no such take.
    """
    unknown = set(parts) - set(PARTS)
    if unknown:
        raise ValueError(f"unknown part {sorted(unknown)[0]!r}; known: {', '.join(PARTS)}")
    scores: Scores = {}
    if "stm" in parts:
        scores["stm"] = evaluate_stm(corpus, pretrained)
    if {"ats", "emotions"} & set(parts):
        model = SpeechToMotion.of(pretrained, steps)
        if "ats" in parts:
            scores["opening"] = evaluate_opening(corpus, model, take, samples)
            scores["closures"] = evaluate_closures(corpus, model)
            for path in audio:
                scores[f"energy {path.name}"] = evaluate_energy(model, path)
        if "emotions" in parts:
            scores["emotions"] = evaluate_emotions(corpus, model)
    return scores


def table(scores: Scores) -> str:
    """The scores as two columns of text."""
    return plain_table([("score", "value"), *_flat(scores)])
