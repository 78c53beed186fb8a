"""Each public layout is read as it lies on disk, unified at the door."""

from __future__ import annotations

import json
import shutil
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_layouts import (
    FLAME,
    SPEAKERS,
    WRITERS,
    face,
    landmark_indices,
    motion_of,
    neutral_of,
    place,
)
from mini_corpus import write_mini_corpus

from freetalk.data import (
    EMOTIONS,
    DatasetError,
    LayoutError,
    MixedDataset,
    MotionDataset,
    RegisteredDataset,
    check_dataset,
    open_dataset,
    open_datasets,
)
from freetalk.data.frames import NpyFrames

pytestmark = pytest.mark.usefixtures("own_cache")


def opened(path: Path) -> RegisteredDataset:
    dataset = open_dataset(path)
    assert isinstance(dataset, RegisteredDataset)
    return dataset


@pytest.mark.parametrize("name", WRITERS)
def test_every_layout_is_recognised_and_without_fault(layouts: Path, name: str) -> None:
    dataset = open_dataset(place(layouts, name))
    assert isinstance(dataset, MotionDataset)
    for split in ("train", "val"):
        assert dataset.sequences(split)
        assert dataset.identities(split)
    report = check_dataset(place(layouts, name))
    assert report.errors == []
    described = report.facts
    assert described["landmarks"]["count"] == 68
    assert len(described["landmarks"]["sha256"]) == 16
    assert described["metres_per_unit"] == (0.001 if name == "biwi" else 1.0)


@pytest.mark.parametrize("name", ["vocaset", "vocaset-faceformer"])
def test_vocaset_is_decimated_to_every_second_frame(layouts: Path, name: str) -> None:
    dataset = opened(place(layouts, name))
    assert (dataset.fps, dataset.file_fps) == (30.0, 60.0)
    assert dataset.describe()["decimated"] == 2
    (sequence,) = dataset.sequences("val")  # VOCA validates on sentences 21 to 40
    assert sequence.id == f"{SPEAKERS[1]}_sentence21"
    assert sequence.num_frames == 31
    neutral = neutral_of(SPEAKERS[1], FLAME)
    true = motion_of(neutral, 61, 60, 21)[::2] - neutral
    # float32 differences of positions of a tenth of a metre
    found = dataset.vertex_displacements("FLAME", sequence, 4, 20)
    np.testing.assert_allclose(found, true[4:20], atol=2e-8)
    marks = dataset.landmarks(sequence, 4, 20)
    np.testing.assert_allclose(marks, true[4:20][:, landmark_indices(face(*FLAME)[0])], atol=2e-8)
    assert np.abs(marks).max() > 0.004
    assert len(dataset.audio(sequence)) == round(61 / 60 * 16000)


def test_both_copies_of_vocaset_hold_the_same_motion(layouts: Path) -> None:
    released, copied = (opened(layouts / n) for n in ("vocaset", "vocaset-faceformer"))
    for one, other in zip(released.sequences(), copied.sequences()):
        assert (one.id, one.split, one.num_frames) == (other.id, other.split, other.num_frames)
        np.testing.assert_array_equal(released.landmarks(one), copied.landmarks(other))
        np.testing.assert_array_equal(released.audio(one), copied.audio(other))


def test_splits_are_the_papers_by_name(layouts: Path) -> None:
    voca, scantalk = (open_dataset(layouts / "vocaset", split=s) for s in ("", "scantalk"))
    assert len(voca.sequences()) == 4  # sentence 1 of the unseen speakers stays out
    assert len(scantalk.sequences()) == 6
    assert [s.voice for s in scantalk.sequences("test")] == [SPEAKERS[2]] * 2
    with pytest.raises(DatasetError, match="vocaset has no split 'mine'; known: voca, scantalk"):
        open_dataset(layouts / "vocaset", split="mine")


def test_a_splits_file_of_ones_own_wins(broken: Callable[[str], Path]) -> None:
    folder = broken("multiface")
    own = {"train": ["20190828", "20181017"], "val": ["20171024"]}
    (folder / "splits.json").write_text(json.dumps(own))
    dataset = open_dataset(folder)
    assert {s.voice for s in dataset.sequences("train")} == set(own["train"])
    assert dataset.sequences("test") == []


def test_millimetres_become_metres(layouts: Path) -> None:
    dataset = opened(layouts / "biwi")
    assert (dataset.pose.unit, dataset.fps) == ("mm", 25.0)
    sequence = dataset.sequences("train")[0]
    assert 0.004 < np.abs(dataset.vertex_displacements("BIWI_6", sequence)).max() < 0.008
    mesh = dataset.mesh(sequence.identity, "BIWI_6")
    assert 0.15 < np.ptp(mesh.vertices, axis=0).max() < 0.3
    assert mesh.lip_mask.any() and mesh.upper_face_mask.any()
    assert not (mesh.lip_mask & mesh.upper_face_mask).any()
    marks = dataset.template.needed_landmarks().of(mesh.vertices)
    np.testing.assert_allclose(marks.mean(axis=0), 0, atol=1e-6)  # centred on its landmarks


def test_axes_are_turned_to_y_up_and_z_forward(broken: Callable[[str], Path]) -> None:
    folder = broken("folder")
    straight = opened(folder)
    sequence = straight.sequences("train")[0]
    expected = straight.vertex_displacements("folder", sequence)
    turn = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z up, y to the left, x forward
    for path in (folder / "motion").glob("*.npy"):
        np.save(path, np.load(path).astype(np.float32) @ turn.T)
    for path in (folder / "templates").glob("*.ply"):
        data, head = path.read_bytes(), path.read_bytes().index(b"end_header\n") + 11
        points = np.frombuffer(data[head : head + 12 * 400], "<f4").reshape(-1, 3)
        path.write_bytes(
            data[:head] + (points @ turn.T).astype("<f4").tobytes() + data[head + 4800 :]
        )
    turned = opened(folder)
    assert turned.describe()["x_y_z_from"] == ["+y", "+z", "+x"]
    np.testing.assert_array_equal(turned.vertex_displacements("folder", sequence), expected)


def test_neutral_sets_are_neutral_at_intensity_1(layouts: Path) -> None:
    for name in ("vocaset", "biwi", "multiface"):
        for sequence in open_dataset(place(layouts, name)).sequences():
            assert (EMOTIONS[sequence.emotion], sequence.intensity) == ("neutral", 1.0)


def test_labels_become_our_vocabulary(layouts: Path) -> None:
    emovoca = open_dataset(place(layouts, "emovoca"))
    found = {(EMOTIONS[s.emotion], s.intensity) for s in emovoca.sequences("train")}
    assert found == {("happy", 1.0), ("ashamed", 2.0)}
    mead = open_dataset(layouts / "mead-emote")
    found = {(EMOTIONS[s.emotion], s.intensity) for s in mead.sequences()}
    assert found == {("neutral", 1.0), ("angry", 3.0), ("surprise", 2.0)}
    own = open_dataset(layouts / "folder")
    found = {(EMOTIONS[s.emotion], s.intensity) for s in own.sequences("test")}
    assert found == {("neutral", 1.0), ("angry", 2.0), ("happy", 3.0)}
    assert {s.text for s in own.sequences()} == {"hello there"}


def test_landmarks_alone_train_the_audio_stage(layouts: Path) -> None:
    sparse, dense = open_dataset(layouts / "landmarks"), open_dataset(layouts / "folder")
    assert sparse.faces() == []
    for one, other in zip(sparse.sequences(), dense.sequences()):
        np.testing.assert_allclose(sparse.landmarks(one), dense.landmarks(other), atol=2e-7)


def test_motion_without_sound_is_silent(broken: Callable[[str], Path]) -> None:
    folder = broken("folder")
    shutil.rmtree(folder / "wav")
    dataset = open_dataset(folder)
    sequence = dataset.sequences("train")[0]
    assert sequence.audio is None
    assert len(dataset.audio(sequence)) == round(sequence.num_frames / 30 * 16000)
    assert not dataset.audio(sequence).any()
    (folder / "dataset.json").unlink()
    with pytest.raises(LayoutError, match="nothing tells the frame rate"):
        open_dataset(folder)


def test_landmarks_are_picked_once_and_kept_on_disk(
    layouts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = open_dataset(layouts / "folder")
    sequence = first.sequences("train")[1]
    expected = first.landmarks(sequence)

    def fail(*_: object) -> None:
        raise AssertionError("the motion is read again")

    monkeypatch.setattr(NpyFrames, "read", fail)
    again = open_dataset(layouts / "folder")
    np.testing.assert_array_equal(again.landmarks(sequence, 3, 9), expected[3:9])
    with pytest.raises(AssertionError):
        again.landmarks(again.sequences("train")[2])


def test_a_window_of_a_huge_file_costs_the_window_alone(tmp_path: Path) -> None:
    path = tmp_path / "huge.npy"
    huge = np.lib.format.open_memmap(path, "w+", np.float16, (200_000, 5023, 3))  # 6 GB, sparse
    huge[150_000] = 1.0
    del huge
    frames = NpyFrames(path, 5023, step=2)
    tracemalloc.start()
    window = frames.read(74_990, 75_010)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert window.shape == (20, 5023, 3)
    assert window.dtype == np.float32
    assert window[10].min() == 1.0 and not window[9].any()
    assert peak < 4 * window.nbytes


def test_an_unknown_folder_is_told_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(LayoutError, match=r"no known dataset.*data_verts\.npy.*vertices_npy"):
        open_dataset(tmp_path / "empty")
    assert not check_dataset(tmp_path / "nowhere").ok


def test_a_mixture_keeps_each_datasets_meshes_and_frame_rate(layouts: Path, tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "open")
    specs = [
        f"OPEN={corpus}",
        f"VOCASET:scantalk={layouts / 'vocaset'}",
        f"BIWI={layouts / 'biwi'}",
    ]
    mixed = open_datasets(specs)
    assert isinstance(mixed, MixedDataset)
    assert isinstance(mixed, MotionDataset)
    alone = {name: mixed.parts[name] for name in ("OPEN", "VOCASET", "BIWI")}
    assert len(mixed.sequences()) == sum(len(part.sequences()) for part in alone.values())
    assert len({s.id for s in mixed.sequences()}) == len(mixed.sequences())
    assert {s.fps for s in mixed.sequences()} == {30.0, 25.0}
    assert {s.source for s in mixed.sequences("train")} >= {"VOCASET", "BIWI", "OPEN/synthetic"}
    assert mixed.topologies("train")[-2:] == ["VOCASET/FLAME", "BIWI/BIWI_6"]
    pairs = mixed.faces("train")
    assert {topology.partition("/")[0] for _, topology in pairs[:3]} == set(alone)
    for sequence in mixed.sequences("val"):
        part, _, own_id = sequence.id.partition("/")
        own = next(s for s in alone[part].sequences() if s.id == own_id)
        np.testing.assert_array_equal(
            mixed.landmarks(sequence, 2, 7), alone[part].landmarks(own, 2, 7)
        )
    last = next(s for s in mixed.sequences("train") if s.dataset == "BIWI")
    assert mixed.mesh(last.identity, str(last.topology)).name.startswith("BIWI/")
    moved = mixed.vertex_displacements(str(last.topology), last, 0, 3)
    assert moved.shape == (3, 3895, 3)
    with pytest.raises(ValueError, match="cannot move a face of VOCASET"):
        mixed.vertex_displacements("VOCASET/FLAME", last)
    with pytest.raises(ValueError, match="two datasets are called"):
        open_datasets([f"A={corpus}", f"A={corpus}"])
