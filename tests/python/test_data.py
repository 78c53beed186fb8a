"""Dataset adapters: what they read is what lies on disk, and what is wrong there is named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import soundfile
from mini_corpus import write_mini_corpus

from freetalk.data import MotionDataset, OpenCorpus, lip_opening


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("data") / "corpus")


def test_open_corpus_is_a_motion_dataset(folder: Path) -> None:
    corpus = OpenCorpus(folder)
    corpus.check()
    assert isinstance(corpus, MotionDataset)
    assert len(corpus.sequences()) == 12
    assert {s.split for s in corpus.sequences("val")} == {"val"}
    assert {s.source for s in corpus.sequences(sources=["rom", "rest"])} == {"rom", "rest"}


def test_frames_of_a_sequence_are_those_of_the_packed_arrays(folder: Path) -> None:
    corpus = OpenCorpus(folder)
    sequence = corpus.sequences("val")[1]
    packed = np.load(folder / "landmarks.npy")
    first = sequence.start_frame
    np.testing.assert_array_equal(corpus.landmarks(sequence, 3, 9), packed[first + 3 : first + 9])
    assert len(corpus.landmarks(sequence)) == sequence.num_frames
    # A window that reaches past the end stops there, never in the next sequence.
    assert len(corpus.landmarks(sequence, sequence.num_frames - 2, 10**6)) == 2


def test_vertices_follow_the_linear_model(folder: Path) -> None:
    corpus = OpenCorpus(folder)
    sequence = corpus.sequences("train")[0]
    data = np.load(folder / "topologies" / "coarse.npz")
    weights = np.load(folder / "weights.npy")[sequence.start_frame + 4]
    expected = np.tensordot(weights, data["expression_basis"].astype(np.float32), axes=1)
    got = corpus.vertex_displacements("coarse", sequence, 4, 5)[0]
    np.testing.assert_allclose(got, expected, atol=1e-8)  # float32 sums of six terms of mm
    coefficients = np.load(folder / "identities.npy")[2]
    moved = data["neutral"] + np.tensordot(
        coefficients, data["identity_basis"].astype(np.float32), axes=1
    )
    np.testing.assert_allclose(corpus.mesh(2, "coarse").vertices, moved, atol=1e-7)


def test_landmark_basis_gives_the_landmarks_back(folder: Path) -> None:
    corpus = OpenCorpus(folder)
    basis, determined = corpus.landmark_basis()
    assert determined.all()
    sequence = corpus.sequences("test")[0]
    again = np.tensordot(corpus.weights(sequence), basis, axes=1)
    np.testing.assert_allclose(again, corpus.landmarks(sequence), atol=1e-7)


def test_a_sequence_without_audio_is_silent_for_its_length(folder: Path) -> None:
    corpus = OpenCorpus(folder)
    sequence = corpus.sequences(sources=["rom"])[0]
    wave = corpus.audio(sequence)
    assert wave.shape == (round(sequence.num_frames / 30 * 16000),)
    assert not wave.any()
    assert corpus.phones(sequence) == []


def test_lip_opening_is_the_growth_of_the_gap() -> None:
    landmarks = np.zeros((2, 68, 3), dtype=np.float32)
    landmarks[1, 62, 1], landmarks[1, 66, 1] = 0.002, -0.005
    np.testing.assert_allclose(lip_opening(landmarks), [0.0, 0.007], rtol=1e-6)


def test_what_is_wrong_with_a_corpus_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no manifest\.json.*freetalk corpus build"):
        OpenCorpus(tmp_path)
    folder = write_mini_corpus(tmp_path / "corpus")
    (folder / "audio" / "0.flac").unlink()
    with pytest.raises(FileNotFoundError, match=r"lacks 1 of .*0\.flac"):
        OpenCorpus(folder).check()
    with pytest.raises(ValueError, match=r"no topology 'cube'.*coarse"):
        OpenCorpus(folder).mesh(0, "cube")
    np.save(folder / "landmarks.npy", np.zeros((3, 68, 3), dtype=np.float32))
    with pytest.raises(ValueError, match=r"landmarks\.npy has shape \(3, 68, 3\)"):
        OpenCorpus(folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["version"] = 2
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(ValueError, match="version 1"):
        OpenCorpus(folder)


def test_audio_of_another_rate_is_refused(tmp_path: Path) -> None:
    folder = write_mini_corpus(tmp_path / "corpus")
    soundfile.write(folder / "audio" / "0.flac", np.zeros(800), 8000)
    corpus = OpenCorpus(folder)
    with pytest.raises(ValueError, match="8000 Hz"):
        corpus.audio(corpus.sequences()[0])
