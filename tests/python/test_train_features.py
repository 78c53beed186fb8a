"""Speech features as a training sees them: cached, and altered as other voices would alter them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import Dataset, open_dataset
from freetalk.train.augment import change_voice
from freetalk.train.config import load_config
from freetalk.train.features import FeatureCache
from freetalk.train.run import make_task

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return open_dataset(write_mini_corpus(tmp_path_factory.mktemp("features") / "corpus"))


@pytest.fixture(scope="module")
def cache(corpus: Dataset, tmp_path_factory: pytest.TempPathFactory) -> FeatureCache:
    config = load_config("ats", CONFIGS / "ats_smoke.yaml", [])
    out = tmp_path_factory.mktemp("task")
    return make_task(config, corpus, out, torch.device("cpu")).features  # type: ignore[union-attr]


def test_the_cache_knows_mean_and_spread_of_its_channels(
    cache: FeatureCache, corpus: Dataset
) -> None:
    rows = [
        cache.features(copy, 0, copy.num_frames)
        for split in ("train", "val")
        for sequence in corpus.sequences(split)
        if sequence.has_sound
        for copy in cache.copies(sequence)
    ]
    every = np.concatenate(rows).astype(np.float64)
    np.testing.assert_allclose(cache.mean, every.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(cache.spread, every.std(axis=0), rtol=1e-4)


def test_noise_differs_by_frame_and_a_shift_does_not(cache: FeatureCache) -> None:
    rng = np.random.default_rng(0)
    still = np.repeat(cache.mean[None], 4000, axis=0)
    noisy = (cache.altered(still, 1.5, 0.0, 0.0, rng) - still) / cache.spread
    np.testing.assert_allclose(noisy.std(axis=0), 1.5, rtol=0.1)
    shifted = (cache.altered(still, 0.0, 2.0, 0.0, rng) - still) / cache.spread
    assert np.ptp(shifted, axis=0).max() < 1e-3  # a constant of each channel
    assert 1.6 < shifted[0].std() < 2.4
    np.testing.assert_array_equal(cache.altered(still, 0.0, 0.0, 0.0, rng), still)


def test_dropped_features_are_the_mean_and_keep_the_expectation(cache: FeatureCache) -> None:
    rng = np.random.default_rng(1)
    away = np.repeat((cache.mean + cache.spread)[None], 4000, axis=0)
    altered = cache.altered(away, 0.0, 0.0, 0.25, rng)
    distance = (altered - cache.mean) / cache.spread
    dropped = np.abs(distance) < 1e-4
    assert dropped.mean() == pytest.approx(0.25, abs=0.01)
    np.testing.assert_allclose(distance[~dropped], 4 / 3, rtol=1e-3)
    assert distance.mean() == pytest.approx(1.0, abs=0.02)


def test_sources_have_copies_in_other_voices(
    cache: FeatureCache, corpus: Dataset, tmp_path: Path
) -> None:
    config = load_config("ats", CONFIGS / "ats_smoke.yaml", ["task.voices={synthetic: 2}"])
    voiced = make_task(config, corpus, tmp_path, torch.device("cpu")).features  # type: ignore[union-attr]
    for sequence in corpus.sequences("train"):
        if not sequence.has_sound:
            continue
        usual, copies = cache.copies(sequence), voiced.copies(sequence)
        assert len(copies) - len(usual) == (2 if sequence.source == "synthetic" else 0)
        np.testing.assert_array_equal(
            voiced.features(copies[0], 0, 10), cache.features(usual[0], 0, 10)
        )
        for copy in copies[len(usual) :]:
            assert copy.speed != 1.0
            assert copy.num_frames == round(sequence.num_frames / copy.speed)


def test_another_voice_is_higher_and_slower_by_itself() -> None:
    times = np.arange(32000) / 16000
    wave = sum(np.sin(2 * np.pi * 150 * k * times) / k for k in range(1, 9)).astype(np.float32)
    pitches, speeds = [], []
    for seed in range(12):
        said, speed = change_voice(wave, np.random.default_rng(seed), 16000)
        assert len(said) == pytest.approx(len(wave) / speed, abs=2)
        spectrum = np.abs(np.fft.rfft(said[4000:20384]))
        pitches.append(float(np.argmax(spectrum)) * 16000 / 16384)
        speeds.append(speed)
    assert np.std(np.log2(np.array(pitches) / 150)) > 0.1
    assert abs(np.corrcoef(pitches, speeds)[0, 1]) < 0.6
