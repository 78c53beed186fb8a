"""The packed layout and the one class that reads it: whole, mixed, cut and at other rates."""

from __future__ import annotations

import json
import multiprocessing
import os
import resource
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_layouts import packed
from mini_corpus import write_mini_corpus

from freetalk.data import (
    Dataset,
    DatasetError,
    LayoutError,
    MissingFileError,
    NotFiniteError,
    PackWriter,
    check_dataset,
    lip_opening,
    open_dataset,
    open_datasets,
    pack_writer,
)
from freetalk.data.pack import Rows

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mini_corpus(tmp_path_factory.mktemp("data") / "corpus")


# Reading


def test_frames_of_a_sequence_are_those_of_the_packed_arrays(folder: Path) -> None:
    corpus = open_dataset(folder)
    assert len(corpus.sequences()) == 12
    assert {s.source for s in corpus.sequences(sources=["rom", "rest"])} == {"rom", "rest"}
    sequence = corpus.sequences("val")[1]
    stored = np.load(folder / "landmarks.npy")
    first = sequence.start_frame
    np.testing.assert_array_equal(corpus.landmarks(sequence, 3, 9), stored[first + 3 : first + 9])
    assert len(corpus.landmarks(sequence)) == sequence.num_frames
    # A window that reaches past the end stops there, never in the next sequence.
    assert len(corpus.landmarks(sequence, sequence.num_frames - 2, 10**6)) == 2


def test_vertices_follow_the_linear_model(folder: Path) -> None:
    corpus = open_dataset(folder)
    sequence = corpus.sequences("train")[0]
    data = np.load(folder / "topologies" / "coarse.npz")
    weights = np.load(folder / "motion.npy")[sequence.start_frame + 4]
    expected = np.tensordot(weights, data["expression_basis"].astype(np.float32), axes=1)
    got = corpus.vertex_displacements("coarse", sequence, 4, 5)[0]
    np.testing.assert_allclose(got, expected, atol=1e-8)  # float32 sums of six terms of mm
    coefficients = np.load(folder / "identities.npy")[2]
    moved = data["neutral"] + np.tensordot(
        coefficients, data["identity_basis"].astype(np.float32), axes=1
    )
    np.testing.assert_allclose(corpus.mesh(2, "coarse").vertices, moved, atol=1e-7)


def test_drawn_weights_move_faces_and_landmarks_as_sequences_do(folder: Path) -> None:
    corpus = open_dataset(folder)
    found = corpus.drawn()
    assert found is not None
    name, expressions, basis = found
    assert (name, expressions) == ("open", corpus.expressions)
    sequence = corpus.sequences("test")[0]
    weights = corpus.weights(sequence)
    again = np.tensordot(weights, basis, axes=1)
    np.testing.assert_allclose(again, corpus.landmarks(sequence), atol=1e-7)
    np.testing.assert_array_equal(
        corpus.displacements_of("coarse", weights), corpus.vertex_displacements("coarse", sequence)
    )


def test_a_sequence_without_sound_is_silent_for_its_length(folder: Path) -> None:
    corpus = open_dataset(folder)
    sequence = corpus.sequences(sources=["rom"])[0]
    wave = corpus.audio(sequence)
    assert wave.shape == (round(sequence.num_frames / 30 * 16000),)
    assert not wave.any() and not sequence.has_sound
    assert corpus.phones(sequence) == []
    assert corpus.phones(corpus.sequences(sources=["synthetic"])[0])[1] == (0.5, 1.0, "P")


def test_lip_opening_is_the_growth_of_the_gap() -> None:
    landmarks = np.zeros((2, 68, 3), dtype=np.float32)
    landmarks[1, 62, 1], landmarks[1, 66, 1] = 0.002, -0.005
    np.testing.assert_allclose(lip_opening(landmarks), [0.0, 0.007], rtol=1e-6)


def test_a_window_of_a_huge_dataset_costs_the_window_alone(tmp_path: Path) -> None:
    path = tmp_path / "huge.npy"
    huge = np.lib.format.open_memmap(path, "w+", np.float16, (200_000, 5023, 3))  # 6 GB, sparse
    huge[150_000] = 1.0
    del huge
    rows = Rows(path)

    def mapped_kb() -> int:
        status = Path("/proc/self/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if "RssFile" in line)

    before = mapped_kb()
    for first in range(0, 200_000, 1000):
        window = rows.read(first, first + 20)
        assert window.shape == (20, 5023, 3) and window.any() == (first == 150_000)
    assert mapped_kb() - before < 4096  # 200 windows are 120 MB; none stays mapped


def test_a_window_is_read_from_the_disk_alone(tmp_path: Path) -> None:
    path = tmp_path / "rows.npy"
    values = np.arange(200_000 * 68 * 3, dtype=np.float32).reshape(-1, 68, 3)  # 163 MB
    np.save(path, values)
    rows = Rows(path)
    with path.open("rb") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_inblock
    for first in range(5000, 195_000, 10_000):
        assert np.array_equal(rows.read(first, first + 30), values[first : first + 30])
    read = 512 * (resource.getrusage(resource.RUSAGE_SELF).ru_inblock - before)
    assert read < 20 * (30 * rows.dtype.itemsize * 68 * 3 + (1 << 18))
    with pytest.raises(DatasetError, match="cut short"):
        rows.read(199_990, 200_010)


def test_a_mixture_keeps_each_datasets_meshes_and_frame_rate(layouts: Path, tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "open")
    folders = {name: tmp_path / name for name in ("vocaset", "biwi")}
    for name, out in folders.items():
        (packed(layouts / name)).rename(out)
    specs = [f"OPEN={corpus}", f"VOCASET:scantalk={folders['vocaset']}", f"BIWI={folders['biwi']}"]
    mixed = open_datasets(specs)
    alone = {
        "OPEN": open_dataset(corpus),
        "VOCASET": open_dataset(folders["vocaset"], split="scantalk"),
        "BIWI": open_dataset(folders["biwi"]),
    }
    assert len(mixed.sequences()) == sum(len(part.sequences()) for part in alone.values())
    assert len({s.id for s in mixed.sequences()}) == len(mixed.sequences())
    assert {s.fps for s in mixed.sequences()} == {30.0, 25.0} and mixed.fps == 30.0
    assert {s.source for s in mixed.sequences("train")} >= {"VOCASET", "BIWI", "OPEN/synthetic"}
    assert mixed.topologies("train")[-2:] == ["VOCASET/FLAME", "BIWI/BIWI_6"]
    pairs = mixed.faces("train")
    assert {topology.partition("/")[0] for _, topology in pairs[:3]} == set(alone)
    at_30 = mixed.at(30.0)
    for sequence in mixed.sequences("val"):
        part, _, own_id = sequence.id.partition("/")
        own = next(s for s in alone[part].sequences() if s.id == own_id)
        expected = alone[part].landmarks(own, 2, 7)
        np.testing.assert_array_equal(mixed.landmarks(sequence, 2, 7), expected)
        np.testing.assert_array_equal(mixed.audio(sequence), alone[part].audio(own))
        if sequence.fps == 30.0:
            again = next(s for s in at_30.sequences("val") if s.id == sequence.id)
            np.testing.assert_array_equal(at_30.landmarks(again, 2, 7), expected)
    last = next(s for s in mixed.sequences("train") if s.dataset == "BIWI")
    mesh = mixed.mesh(last.identity, str(last.topology))
    assert mesh.name.startswith("BIWI/F") and mesh.dataset == "BIWI"
    assert mixed.vertex_displacements(str(last.topology), last, 0, 3).shape == (3, 3895, 3)
    with pytest.raises(ValueError, match="cannot move a face of VOCASET"):
        mixed.vertex_displacements("VOCASET/FLAME", last)
    with pytest.raises(ValueError, match="two datasets are called"):
        open_datasets([f"A={corpus}", f"A={corpus}"])


def test_a_clip_is_the_take_from_there_on(folder: Path) -> None:
    corpus = open_dataset(folder)
    whole = corpus.sequences("train")[0]
    part = corpus.select([whole.clip("part", 20, 30)], name="cut")
    (clip,) = part.sequences()
    assert (clip.dataset, clip.num_frames) == ("cut", 30)
    np.testing.assert_array_equal(part.landmarks(clip, 5, 9), corpus.landmarks(whole, 25, 29))
    wave = corpus.audio(whole)
    np.testing.assert_array_equal(
        part.audio(clip), wave[round(20 / 30 * 16000) : round(50 / 30 * 16000)]
    )
    assert part.fingerprint != corpus.fingerprint
    spoken = corpus.sequences("train", ["synthetic"])[0].clip("later", 18, 30)
    found = corpus.select([spoken]).phones(spoken)  # from 0.6 s to 1.6 s of the take
    assert [label for _, _, label in found] == ["P", "AA"]
    np.testing.assert_allclose([p[:2] for p in found], [(-0.1, 0.4), (0.4, 1.2)], atol=1e-9)


# What is wrong


def test_what_is_wrong_with_a_packed_folder_is_named(layouts: Path, tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="is no folder"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(LayoutError, match=r"not packed: run 'freetalk data import biwi \S+ --out"):
        open_dataset(layouts / "biwi")
    folder = write_mini_corpus(tmp_path / "corpus")
    with pytest.raises(ValueError, match=r"no topology 'cube'.*coarse"):
        open_dataset(folder).mesh(0, "cube")
    with pytest.raises(DatasetError, match="has no split 'mine'; known: corpus"):
        open_dataset(folder, split="mine")
    landmarks = np.load(folder / "landmarks.npy")
    np.save(folder / "landmarks.npy", landmarks[:3])
    with pytest.raises(DatasetError, match=r"landmarks\.npy has shape \(3, 68, 3\), the manifest"):
        open_dataset(folder)
    landmarks[7, 3] += 0.001
    np.save(folder / "landmarks.npy", landmarks)
    report = check_dataset(folder)
    assert report.errors == ["facegood_train is not what was written: import the dataset anew"]
    assert check_dataset(folder, quick=True).ok
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["version"] = 0
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(DatasetError, match="version 0, expected freetalk-dataset version 1"):
        open_dataset(folder)


# Writing


def takes(count: int = 40) -> list[tuple[dict[str, Any], np.ndarray, np.ndarray, np.ndarray]]:
    """Entries, landmarks, motion and samples of takes that differ."""
    made = []
    for number in range(count):
        rng = np.random.default_rng(number)
        frames = 10 + number % 7
        entry = {
            "id": f"take{number:03d}", "split": ["train"], "source": "made", "take": None, "emotion": "neutral",
            "intensity": 1.0, "identity": 0, "voice": None, "text": None,
        }  # fmt: skip
        landmarks = rng.normal(0, 0.01, (frames, 68, 3)).astype(np.float32)
        sound = rng.integers(-9, 9, frames * 640).astype(np.int16)
        made.append((entry, landmarks, landmarks[:, :5], sound))
    return made


def finish(writer: PackWriter) -> None:
    mesh = {
        "neutral": np.zeros((5, 3)), "faces": np.array([[0, 1, 2]]), "identity_basis": np.zeros((1, 5, 3)),
        "lip_mask": np.zeros(5, bool), "upper_face_mask": np.zeros(5, bool),
    }  # fmt: skip
    manifest = {
        "name": "made", "fps": 25.0, "expressions": [], "moves": "own", "splits": {"all": "of it"}, "facts": {},
        "identities": [{"name": "a", "origin": [0.0, 0.0, 0.0]}],
        "topologies": [{"name": "m", "file": "topologies/m.npz", "num_vertices": 5, "num_faces": 1}],
    }  # fmt: skip
    writer.finish(manifest, np.eye(1), {"m": mesh})


def write_all(out: Path, key: str = "a", after: Callable[[int], None] = lambda number: None) -> int:
    """Writes what is not there yet; returns how many takes that was."""
    with PackWriter(out, {"of": key}) as writer:
        if writer.complete:
            return 0
        written = 0
        for number, (entry, landmarks, motion, sound) in enumerate(takes()):
            if writer.knows(entry["id"]):
                continue
            after(number)
            if number % 10 == 3:
                writer.exclude(entry["id"], "it is the third")
            else:
                writer.add(entry, landmarks, motion, sound)
            written += 1
        finish(writer)
    return written


def content(out: Path) -> dict[str, bytes]:
    files = ("manifest.json", "landmarks.npy", "motion.npy", "audio.npy")
    return {name: (out / name).read_bytes() for name in files}


@pytest.mark.parametrize("at", [0, 9, 25])
def test_a_writer_that_is_killed_goes_on_where_it_was(
    at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pack_writer, "_COMMIT_TAKES", 4)
    write_all(tmp_path / "whole")

    def kill(number: int) -> None:
        if number == at:
            os.kill(os.getpid(), signal.SIGKILL)

    child = multiprocessing.get_context("fork").Process(
        target=write_all, args=(tmp_path / "out", "a", kill)
    )
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert not (tmp_path / "out").exists()  # nothing half-written counts
    with (tmp_path / ".out.partial" / "journal").open("a") as journal:
        journal.write('{"take": {"id": "ta')  # a line that was cut off
    left = write_all(tmp_path / "out")
    assert 40 - at <= left <= 40 - at + 4
    assert content(tmp_path / "out") == content(tmp_path / "whole")
    assert write_all(tmp_path / "out") == 0
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []
    dataset = open_dataset(tmp_path / "out")
    assert len(dataset.sequences()) == 36
    moved = dataset.vertex_displacements("m", dataset.sequences()[5])
    np.testing.assert_allclose(moved, takes()[6][2], rtol=2**-11, atol=2**-25)  # float16


def test_a_full_disk_leaves_what_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pack_writer, "_COMMIT_TAKES", 4)
    write_all(tmp_path / "whole")
    flush, room = pack_writer._flush, [9]

    def full(file: Any) -> None:
        room[0] -= 1
        if room[0] < 0:
            raise OSError(28, "No space left on device")
        flush(file)

    monkeypatch.setattr(pack_writer, "_flush", full)
    with pytest.raises(OSError, match="No space left"):
        write_all(tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(pack_writer, "_flush", flush)
    assert 0 < write_all(tmp_path / "out") < 40
    assert content(tmp_path / "out") == content(tmp_path / "whole")


def test_of_two_writers_one_is_told_to_wait(tmp_path: Path) -> None:
    held = tmp_path / "held"

    def wait(number: int) -> None:
        if number == 5:
            held.touch()
            while held.exists():
                time.sleep(0.01)

    child = multiprocessing.get_context("fork").Process(
        target=write_all, args=(tmp_path / "out", "a", wait)
    )
    child.start()
    while not held.exists():
        time.sleep(0.01)
    with pytest.raises(DatasetError, match="another process is writing"):
        write_all(tmp_path / "out")
    held.unlink()
    child.join()
    assert child.exitcode == 0
    assert write_all(tmp_path / "out") == 0  # it is there


def test_another_dataset_is_never_written_over(tmp_path: Path) -> None:
    write_all(tmp_path / "out")
    before = content(tmp_path / "out")
    with pytest.raises(DatasetError, match="holds another dataset"):
        write_all(tmp_path / "out", "b")
    assert content(tmp_path / "out") == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "manifest.json").write_text('{"name": "my page"}')
    for replace in (False, True):
        with pytest.raises(DatasetError, match="is no dataset"):
            PackWriter(tmp_path / "mine", {}, replace=replace).__enter__()

    def stop(number: int) -> None:
        if number == 9:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_all(tmp_path / "other", "b", stop)
    with pytest.raises(DatasetError, match="unfinished work of another source"):
        write_all(tmp_path / "other", "c")
    assert write_all(tmp_path / "other", "b") == 31  # what came before the stop was kept


def test_takes_of_one_sound_share_its_samples_and_frames_are_finite(tmp_path: Path) -> None:
    with PackWriter(tmp_path / "out", {}) as writer:
        for number, (entry, landmarks, motion, sound) in enumerate(takes(3)):
            heard = sound if number == 0 else sound[:0]
            writer.add(entry, landmarks, motion, heard, sound="the same", phones=[[0, 1, "sil"]])
        entry, landmarks, motion, sound = takes(4)[3]
        landmarks[4, 0, 0] = np.nan
        with pytest.raises(NotFiniteError, match="take003, frame 4 holds NaN"):
            writer.add(entry, landmarks, motion, sound)
        finish(writer)
    dataset = open_dataset(tmp_path / "out")
    assert check_dataset(tmp_path / "out").errors == []
    for sequence in dataset.sequences():
        np.testing.assert_array_equal(dataset.audio(sequence) * 32768, takes(1)[0][3])
        assert dataset.phones(sequence) == [(0.0, 1.0, "sil")]


def test_a_part_of_a_dataset_is_read_by_other_processes(folder: Path) -> None:
    corpus: Dataset = open_dataset(folder)
    sequence = corpus.sequences("train")[0]
    with multiprocessing.get_context("fork").Pool(2) as pool:
        found = pool.starmap(corpus.landmarks, [(sequence, 0, 5), (sequence, 5, 10)])
    np.testing.assert_array_equal(np.concatenate(found), corpus.landmarks(sequence, 0, 10))
