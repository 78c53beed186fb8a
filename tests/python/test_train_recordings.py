"""Recorded speech without a face in the speech encoder's training: it teaches phones, and no motion."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
import torch
from mini_corpus import write_mini_corpus

from freetalk.data import open_dataset
from freetalk.train import load_config
from freetalk.train.run import make_task
from freetalk.train.speech_recordings import RECORDED, Recordings
from freetalk.train.speech_targets import SpeechTargets

CONFIGS = Path(__file__).parents[2] / "configs"
PHONES = [[0.0, 0.4, "sil"], [0.4, 0.9, "AH"], [0.9, 1.4, "M"], [1.4, 2.0, "K"]]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = write_mini_corpus(tmp_path_factory.mktemp("recordings") / "corpus")
    file = directory / "phones.json"  # give it a schwa
    phones = json.loads(file.read_text())
    file.write_text(json.dumps({k: [*v, [1.8, 2.0, "AX"]] for k, v in phones.items()}))
    return directory


@pytest.fixture(scope="module")
def aligned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("real")
    times = np.arange(2 * 16000) / 16000
    soundfile.write(folder / "a.wav", 0.3 * np.sin(2 * np.pi * 440 * times), 16000)
    (folder / "phones.json").write_text(json.dumps({"a.wav": PHONES}))
    return folder / "phones.json"


def test_a_batch_of_recordings_holds_their_phones_and_no_motion(
    corpus: Path, aligned: Path, tmp_path: Path
) -> None:
    options = ["loop.threads=1", "loop.device=cpu", f"task.recordings=[{aligned}]"]
    options += ["task.source_weights={recorded: 1.0, synthetic: 1e-9}", "task.augment=0"]
    options += ["task.speed_range=0", "task.pieces=1"]
    config = load_config("speech", CONFIGS / "speech_smoke.yaml", options)
    task = make_task(config, open_dataset(corpus), tmp_path, torch.device("cpu"))
    generator = torch.Generator().manual_seed(3)
    rng = np.random.default_rng(3)
    batch = task.collate([task.item(rng, number) for number in range(config.loop.batch_size)])
    names = {name: task.targets.phones.index(name) for name in ("sil", "AH", "M", "K")}
    assert set(batch["phones"].flatten().tolist()) == set(names.values())
    assert not batch["moving"].any() and batch["valid"].any()
    terms = task.loss(batch, generator)
    assert terms["phones"] > 0 and terms["curves"] == 0 and terms["opening"] == 0


def test_another_voice_says_the_same_phones_at_its_own_tempo(corpus: Path, tmp_path: Path) -> None:
    """A take that is silent in its pauses still is where its labels say so, however it is said."""
    times = np.arange(6 * 16000) / 16000
    heard = times % 1.0 > 0.5
    soundfile.write(tmp_path / "a.wav", 0.3 * heard * np.sin(2 * np.pi * 300 * times), 16000)
    labels = [[n / 2, (n + 1) / 2, "AH" if n % 2 else "sil"] for n in range(12)]
    (tmp_path / "phones.json").write_text(json.dumps({"a.wav": labels}))
    options = [f"task.recordings=[{tmp_path / 'phones.json'}]", "task.voices=1", "task.augment=0"]
    options += ["task.source_weights={recorded: 1.0, synthetic: 1e-9}", "task.pieces=1"]
    config = load_config("speech", CONFIGS / "speech_smoke.yaml", [*options, "loop.device=cpu"])
    task = make_task(config, open_dataset(corpus), tmp_path, torch.device("cpu"))
    rng = np.random.default_rng(4)
    agreed, tempos = [], set()
    for number in range(12):
        item = task.item(rng, number)
        silent = item["phones"] == task.targets.phones.index("sil")
        middles = 200 + 320 * np.arange(len(silent))
        level = np.array([np.abs(item["clean"][max(0, m - 80) : m + 80]).max() for m in middles])
        agreed += ((level < 0.05) == silent)[item["valid"]].tolist()
        tempos.add(int(np.ptp(np.flatnonzero(np.diff(silent.astype(int))))))
    assert np.mean(agreed) > 0.93 and len(tempos) > 2


def test_the_dictionarys_schwa_is_ah_only_beside_recordings(corpus: Path, aligned: Path) -> None:
    reader = open_dataset(corpus)
    train = [s for s in reader.sequences("train") if s.has_sound]
    alone = SpeechTargets(reader, train)
    assert {"AX", "AA"} <= set(alone.phones)
    recordings = Recordings([str(aligned)], reader.fps)
    both = SpeechTargets(reader, [*train, *recordings.sequences], recordings)
    assert "AX" not in both.phones
    synthetic = next(s for s in train if s.source == "synthetic")
    at_schwa = both.phones_at(synthetic, np.array([1.9], np.float32))
    assert at_schwa.tolist() == [both.phones.index("AH")]
    # What the corpus teaches of motion does not depend on the recordings.
    times = np.linspace(0, 2, 9, dtype=np.float32)
    for found, expected in zip(both.motion_at(synthetic, times), alone.motion_at(synthetic, times)):
        np.testing.assert_array_equal(found, expected)
    heard = both.motion_at(recordings.sequences[0], times)
    assert heard[0].shape == (9, both.num_curves) and not heard[0].any() and not heard[1].any()


def test_recordings_are_where_their_file_says(aligned: Path, tmp_path: Path) -> None:
    recordings = Recordings([str(aligned)], 30.0)
    (sequence,) = recordings.sequences
    assert (sequence.source, sequence.num_frames) == (RECORDED, 60)
    assert len(recordings.audio(sequence)) == 2 * 16000
    (tmp_path / "phones.json").write_text(json.dumps({"gone.wav": PHONES}))
    with pytest.raises(FileNotFoundError, match=r"names gone\.wav, but there is no"):
        Recordings([str(tmp_path / "phones.json")], 30.0)
    with pytest.raises(ValueError, match="already among the recordings"):
        Recordings([str(aligned), str(aligned)], 30.0)


def test_recordings_alone_are_refused(corpus: Path, aligned: Path) -> None:
    reader = open_dataset(corpus)
    recordings = Recordings([str(aligned)], reader.fps)
    with pytest.raises(ValueError, match="recordings alone teach no motion"):
        SpeechTargets(reader, recordings.sequences, recordings)
