"""Windows and crops joined from pieces of several takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import Dataset, MotionSequence, open_dataset
from freetalk.train.config import load_config
from freetalk.train.mosaic import Mosaics, blended, faded
from freetalk.train.sequences import numpy_generator
from freetalk.train.speech import SpeechTask

CONFIGS = Path(__file__).parents[2] / "configs"


def take(name: str, emotion: int, intensity: float, fps: float = 30.0) -> MotionSequence:
    return MotionSequence(
        name, "train", "talk", name, 0, 300, 300, 0, 0, emotion, intensity, 0, None, None, fps
    )


def test_a_mosaic_joins_takes_of_one_emotion_intensity_and_frame_rate() -> None:
    wanted = [take("a", 1, 2.0), take("b", 1, 2.0)]
    others = [take("c", 2, 2.0), take("d", 1, 3.0), take("e", 1, 2.0, fps=25.0)]
    mosaics = Mosaics([*wanted, *others], {"talk": 1.0})
    used: set[str] = set()

    def piece(source: MotionSequence, frames: int) -> tuple[np.ndarray, np.ndarray]:
        used.add(source.id)
        return np.ones((frames, 3), np.float32), np.ones((frames, 68, 3), np.float32)

    for seed in range(20):
        audio, motion = mosaics.window(wanted[0], 150, piece, np.random.default_rng(seed))
        assert audio.shape == (150, 3) and motion.shape == (150, 68, 3)
        np.testing.assert_allclose(motion, 1.0, rtol=1e-6)  # fades of ones are ones
    assert used == {"a", "b"}


def test_pieces_fade_without_a_jump() -> None:
    joined = faded(np.zeros((10, 2), np.float32), np.ones((10, 2), np.float32))
    assert len(joined) == 16
    assert np.abs(np.diff(joined, axis=0)).max() <= 0.2 + 1e-6  # a fifth a frame


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return open_dataset(write_mini_corpus(tmp_path_factory.mktemp("mosaic") / "corpus"))


def test_speech_crops_join_pieces_with_their_own_targets(corpus: Dataset, tmp_path: Path) -> None:
    overrides = ["task.pieces=3", "task.motion_sources=[synthetic]", "task.crop_s=2.0"]
    config = load_config("speech", CONFIGS / "speech_smoke.yaml", overrides)
    task = SpeechTask(config, corpus, tmp_path, torch.device("cpu"))
    rng = numpy_generator(torch.Generator().manual_seed(0))
    mixed = 0
    for _ in range(12):
        crop = task._crop(task.sampler.draw(rng), rng)
        assert len(crop["wave"]) == len(crop["clean"]) == 32000
        frames = task.model.encoder.num_frames(32000)
        assert {len(crop[key]) for key in ("phones", "curves", "opening", "source")} == {frames}
        named = np.array(task.sources)[crop["source"]]
        np.testing.assert_array_equal(crop["moving"], named == "synthetic")
        mixed += len(set(crop["source"].tolist())) > 1
    assert mixed > 0


def test_a_blend_is_convex_in_all_that_the_windows_hold() -> None:
    def window(frames: int, value: float, emotion: int) -> dict[str, object]:
        return {
            "audio": np.full((frames, 5), value, np.float32),
            "motion": np.full((frames, 6), -value, np.float32),
            "emotion": np.eye(3, dtype=np.float32)[emotion],
            "intensity": 1.0 + 2 * value,
        }

    rng = np.random.default_rng(0)
    shares = []
    for _ in range(200):
        mixed = blended(window(20, 0.0, 0), window(12, 1.0, 2), rng)
        share = float(mixed["intensity"] - 1) / 2
        assert mixed["audio"].shape == (12, 5) and mixed["motion"].dtype == np.float32
        np.testing.assert_allclose(mixed["audio"], share, atol=1e-6)
        np.testing.assert_allclose(mixed["motion"], -share, atol=1e-6)
        np.testing.assert_allclose(mixed["emotion"], [1 - share, 0, share], atol=1e-6)
        shares.append(share)
    assert min(shares) < 0.02 and max(shares) > 0.98 and 0.4 < np.mean(shares) < 0.6
