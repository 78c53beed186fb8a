"""Each public release is packed as it really lies on disk: what is good comes over, what is bad is left out and named."""

from __future__ import annotations

import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundfile
from dataset_layouts import (
    BIWI_6,
    FLAME,
    MULTIFACE,
    SPEAKERS,
    WRITERS,
    face,
    landmark_indices,
    motion_of,
    neutral_of,
    packed,
    place,
    sound,
    write_folder,
    write_mead_emote,
)

from freetalk.cli.app import main
from freetalk.data import (
    EMOTIONS,
    Dataset,
    DatasetError,
    LayoutError,
    MissingFileError,
    MissingLandmarksError,
    MissingTemplateError,
    UnsafePickleError,
    check_dataset,
    import_dataset,
    open_dataset,
)
from freetalk.data.flame import read_flame
from freetalk.data.resampling import resample_frames

pytestmark = pytest.mark.usefixtures("own_cache")


@pytest.fixture(scope="module")
def packs(layouts: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every layout, packed."""
    root = tmp_path_factory.mktemp("packs")
    for name in WRITERS:
        import_dataset("auto", place(layouts, name), root / name)
    return root


def excluded(folder: Path) -> dict[str, str]:
    manifest = json.loads((folder / "manifest.json").read_text())
    return {entry["id"]: entry["reason"] for entry in manifest["excluded"]}


def ids(dataset: Dataset, split: str) -> list[str]:
    return [s.id for s in dataset.sequences(split)]


# What comes over


@pytest.mark.parametrize("name", WRITERS)
def test_every_layout_is_recognised_and_comes_over_whole(
    packs: Path, layouts: Path, name: str
) -> None:
    dataset = open_dataset(packs / name)
    for split in ("train", "val"):
        assert dataset.sequences(split)
        assert dataset.identities(split)
    report = check_dataset(packs / name)
    assert (report.errors, report.excluded) == ([], {})
    assert check_dataset(place(layouts, name)).ok
    facts = report.facts
    assert facts["landmarks"]["count"] == 68 and len(facts["landmarks"]["sha256"]) == 16
    assert facts["metres_per_unit"] == (0.001 if name == "biwi" else 1.0)


@pytest.mark.parametrize("name", ["vocaset", "vocaset-faceformer"])
def test_vocaset_is_decimated_to_every_second_frame(packs: Path, name: str) -> None:
    dataset = open_dataset(packs / name)
    assert (dataset.fps, dataset.describe()["fps_of_files"]) == (30.0, 60.0)
    (sequence,) = dataset.sequences("val")  # VOCA validates on sentences 21 to 40
    assert sequence.id == f"{SPEAKERS[1]}_sentence21"
    assert sequence.num_frames == 31
    true = motion_of(neutral_of(SPEAKERS[1], FLAME), 61, 60, 21)[::2]
    true -= neutral_of(SPEAKERS[1], FLAME)
    # Landmarks are float32 differences of a decimetre, vertices float16: 11 digits of 6 mm.
    marks = dataset.landmarks(sequence, 4, 20)
    np.testing.assert_allclose(marks, true[4:20][:, landmark_indices(face(*FLAME)[0])], atol=2e-8)
    found = dataset.vertex_displacements("FLAME", sequence, 4, 20)
    np.testing.assert_allclose(found, true[4:20], rtol=2**-11, atol=5e-8)
    assert np.abs(marks).max() > 0.004
    assert len(dataset.audio(sequence)) == round(61 / 60 * 16000)


def test_both_copies_of_vocaset_hold_the_same_motion(packs: Path) -> None:
    released, copied = (open_dataset(packs / n) for n in ("vocaset", "vocaset-faceformer"))
    for one, other in zip(released.sequences(), copied.sequences(), strict=True):
        assert (one.id, one.split, one.num_frames) == (other.id, other.split, other.num_frames)
        np.testing.assert_array_equal(released.landmarks(one), copied.landmarks(other))
        np.testing.assert_array_equal(released.audio(one), copied.audio(other))


def test_motion_comes_at_the_rate_that_is_asked_for(layouts: Path, tmp_path: Path) -> None:
    given = open_dataset(packed(layouts / "biwi"))
    at_30 = open_dataset(import_dataset("biwi", layouts / "biwi", tmp_path / "at30", fps=30))
    assert (given.fps, at_30.fps) == (25.0, 30.0)
    for one, other in zip(given.sequences(), at_30.sequences(), strict=True):
        expected = resample_frames(given.landmarks(one), 25.0, 30.0)
        assert abs(len(expected) - other.num_frames) <= 1
        found = at_30.landmarks(other)[: len(expected)]
        np.testing.assert_allclose(found, expected[: len(found)], atol=1e-7)


def test_millimetres_become_metres(packs: Path) -> None:
    dataset = open_dataset(packs / "biwi")
    assert (dataset.describe()["unit"], dataset.fps) == ("mm", 25.0)
    sequence = dataset.sequences("train")[0]
    moved = dataset.vertex_displacements("BIWI_6", sequence)
    assert 0.004 < np.abs(moved).max() < 0.008
    mesh = dataset.mesh(sequence.identity, "BIWI_6")
    assert 0.15 < np.ptp(mesh.vertices, axis=0).max() < 0.3
    assert mesh.lip_mask.any() and mesh.upper_face_mask.any()
    assert not (mesh.lip_mask & mesh.upper_face_mask).any()
    np.testing.assert_allclose(mesh.vertices[mesh.landmarks].mean(axis=0), 0, atol=1e-6)


def test_axes_are_turned_to_y_up_and_z_forward(broken: Callable[[str], Path]) -> None:
    folder = broken("folder")
    straight = open_dataset(packed(folder))
    sequence = straight.sequences("train")[0]
    turn = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])  # z up, y to the left, x forward
    for path in (folder / "motion").glob("*.npy"):
        np.save(path, np.load(path).astype(np.float32) @ turn.T)
    for path in (folder / "templates").glob("*.ply"):
        data, head = path.read_bytes(), path.read_bytes().index(b"end_header\n") + 11
        points = np.frombuffer(data[head : head + 12 * 400], "<f4").reshape(-1, 3)
        turned = (points @ turn.T).astype("<f4").tobytes()
        path.write_bytes(data[:head] + turned + data[head + 4800 :])
    dataset = open_dataset(import_dataset("folder", folder, folder.with_name("turned")))
    assert dataset.describe()["x_y_z_from"] == ["+y", "+z", "+x"]
    np.testing.assert_array_equal(
        dataset.vertex_displacements("folder", sequence),
        straight.vertex_displacements("folder", sequence),
    )
    pose, origin = dataset.source_frame(sequence)
    back = pose.undo(dataset.mesh(sequence.identity, "folder").vertices) + origin
    np.testing.assert_allclose(back, neutral_of("ann", (400, 760)) @ turn.T, atol=1e-7)


def test_labels_become_our_vocabulary(packs: Path) -> None:
    def found(name: str, split: str | None) -> set[tuple[str, float]]:
        sequences = open_dataset(packs / name).sequences(split)
        return {(EMOTIONS[s.emotion], s.intensity) for s in sequences}

    for name in ("vocaset", "biwi", "multiface"):
        assert found(name, None) == {("neutral", 1.0)}
    assert found("emovoca", "train") == {("happy", 1.0), ("ashamed", 2.0)}
    assert found("mead-emote", None) == {("neutral", 1.0), ("angry", 3.0), ("surprise", 2.0)}
    assert found("folder", "test") == {("neutral", 1.0), ("angry", 2.0), ("happy", 3.0)}
    assert {s.text for s in open_dataset(packs / "folder").sequences()} == {"hello there"}


def test_flame_is_packed_as_its_factors_and_read_as_its_vertices(
    packs: Path, layouts: Path
) -> None:
    dataset, flame = (
        open_dataset(packs / "mead-emote"),
        read_flame(layouts / "mead-emote/flame.npz"),
    )
    assert np.load(packs / "mead-emote" / "motion.npy", mmap_mode="r").shape[1] == 109
    root = layouts / "mead-emote/processed/reconstructions/EMICA-MEAD_flame2020"
    arrays = dict(np.load(layouts / "mead-emote/flame.npz"))
    for name in ("M003_angry_level_3_001", "W011_neutral_level_1_001"):
        speaker, label, _, level, take = name.split("_")
        (sequence,) = [s for s in dataset.sequences() if s.id == name]
        with h5py.File(
            root / speaker / "front" / label / f"level_{level}" / take / "shape_pose_cam.hdf5"
        ) as file:
            expression, jaw = file["exp"][0], file["jaw"][0]
        neutral = dataset.mesh(sequence.identity, "FLAME").vertices.astype(np.float64)
        mean = neutral_of_actor(root / speaker, flame)
        np.testing.assert_allclose(neutral - neutral[0], mean - mean[0], atol=1e-7)
        moved = posed(arrays, mean, expression, jaw) - mean
        found = dataset.vertex_displacements("FLAME", sequence)
        np.testing.assert_allclose(found, moved, atol=3e-7)  # float32 of decimetres
        marks = dataset.mesh(sequence.identity, "FLAME").landmarks
        np.testing.assert_allclose(dataset.landmarks(sequence), moved[:, marks], atol=3e-7)


def neutral_of_actor(folder: Path, flame) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The mean shape of the actor's first take in the order of the names."""
    first = sorted(folder.glob("front/*/*/*/shape_pose_cam.hdf5"))[0]
    with h5py.File(first) as file:
        return flame.neutral(file["shape"][0].mean(axis=0)).astype(np.float64)


def posed(
    arrays: dict[str, np.ndarray], neutral: np.ndarray, expression: np.ndarray, jaw: np.ndarray
) -> np.ndarray:
    """FLAME's published equations: the whole chain of global, neck, jaw and two eyes."""
    frames = []
    for coefficients, vector in zip(expression, jaw, strict=True):
        shaped = neutral + arrays["shapedirs"][..., 300:] @ coefficients
        joints = arrays["J_regressor"] @ shaped
        turns = np.repeat(np.eye(3)[None], 5, axis=0)
        angle = np.linalg.norm(vector)
        x, y, z = vector / angle
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turns[2] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        corrected = shaped + arrays["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
        world = np.zeros((5, 4, 4))
        for joint, parent in enumerate((-1, 0, 1, 1, 1)):
            local = np.eye(4)
            local[:3, :3] = turns[joint]
            local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
            world[joint] = local if parent < 0 else world[parent] @ local
        for joint in range(5):
            world[joint, :3, 3] -= world[joint, :3, :3] @ joints[joint]
        blended = np.einsum("vj,jab->vab", arrays["weights"], world)
        points = np.concatenate([corrected, np.ones((len(corrected), 1))], axis=1)
        frames.append(np.einsum("vab,vb->va", blended, points)[:, :3])
    return np.stack(frames)


def test_landmarks_alone_train_the_audio_stage(packs: Path) -> None:
    sparse, dense = open_dataset(packs / "landmarks"), open_dataset(packs / "folder")
    assert sparse.faces() == [] and sparse.topologies() == []
    for one, other in zip(sparse.sequences(), dense.sequences(), strict=True):
        np.testing.assert_allclose(sparse.landmarks(one), dense.landmarks(other), atol=2e-7)


def test_motion_without_sound_is_silent(broken: Callable[[str], Path]) -> None:
    folder = broken("folder")
    shutil.rmtree(folder / "wav")
    dataset = open_dataset(packed(folder))
    sequence = dataset.sequences("train")[0]
    assert not sequence.has_sound
    assert len(dataset.audio(sequence)) == round(sequence.num_frames / 30 * 16000)
    (folder / "dataset.json").unlink()
    with pytest.raises(LayoutError, match="nothing tells the frame rate"):
        import_dataset("folder", folder, folder.with_name("other"))


# Splits


def test_splits_are_the_papers_by_name(packs: Path, tmp_path: Path) -> None:
    voca, scantalk = (open_dataset(packs / "vocaset", split=s) for s in ("", "scantalk"))
    assert len(voca.sequences()) == 4  # sentence 1 of the unseen speakers stays out
    assert len(scantalk.sequences()) == 6
    assert [s.voice for s in scantalk.sequences("test")] == [SPEAKERS[2]] * 2
    with pytest.raises(DatasetError, match="has no split 'mine'; known: voca, scantalk"):
        open_dataset(packs / "vocaset", split="mine")
    mead = [open_dataset(packs / "mead-emote", split=s) for s in ("freetalk", "emote")]
    assert mead[0].fingerprint != mead[1].fingerprint


def test_a_splits_file_of_ones_own_comes_first(broken: Callable[[str], Path]) -> None:
    folder = broken("multiface")
    own = {"train": ["20190828", "20181017"], "val": ["20171024"]}
    (folder / "splits.json").write_text(json.dumps(own))
    dataset = open_dataset(packed(folder))
    assert {s.voice for s in dataset.sequences("train")} == set(own["train"])
    assert dataset.sequences("test") == []
    assert len(open_dataset(packed(folder), split="scantalk").sequences("test")) == 1


def write_biwi(folder: Path, stems: list[str]) -> Path:
    """BIWI with takes of these names, 25 fps."""
    for name in ("vertices_npy", "wav"):
        (folder / name).mkdir(parents=True)
    neutral = {}
    for number, stem in enumerate(stems):
        speaker = stem.partition("_")[0]
        neutral[speaker] = neutral_of(speaker, BIWI_6)
        motion = motion_of(neutral[speaker], 20, 25, number)
        np.save(folder / "vertices_npy" / f"{stem}.npy", motion.reshape(20, -1))
        soundfile.write(folder / "wav" / f"{stem}.wav", sound(0.8, 16000, number), 16000)
    (folder / "templates.pkl").write_bytes(pickle.dumps(neutral, protocol=2))
    from dataset_layouts import write_lists, write_obj

    write_obj(folder / "templates" / "BIWI.obj", *face(*BIWI_6))
    write_lists(folder, BIWI_6, ("landmarks68.npy", "lve.npy", "fdd.npy"))
    return folder


NEUTRAL = ["F2_01", "F2_33", "M3_40", "F7_02", "F8_03"]
EMOTIONAL = ["F2_e01", "F2_e33", "M3_e40", "F8_e38", "F8_e03"]


def test_biwi_with_both_variants_splits_each_by_its_protocol(tmp_path: Path) -> None:
    folder = packed(write_biwi(tmp_path / "biwi", [*NEUTRAL, *EMOTIONAL]))
    scantalk = open_dataset(folder)
    assert {s: ids(scantalk, s) for s in ("train", "val", "test")} == {
        "train": ["F2_01", "F2_33", "M3_40"], "val": ["F7_02"], "test": ["F8_03"],
    }  # fmt: skip
    faceformer = open_dataset(folder, split="faceformer")
    assert {s: ids(faceformer, s) for s in ("train", "val", "test")} == {
        "train": ["F2_e01"], "val": ["F2_e33"], "test": ["F8_e38"],
    }  # fmt: skip
    # Out of every protocol: FaceFormer tests on sentences 37 to 40.
    assert excluded(folder).keys() == {"F8_e03", "M3_e40"}
    assert "belongs to no split of scantalk, faceformer" in excluded(folder)["F8_e03"]


def test_biwi_with_the_emotional_takes_alone_opens_with_their_protocol(tmp_path: Path) -> None:
    folder = packed(write_biwi(tmp_path / "biwi", EMOTIONAL))
    dataset = open_dataset(folder)
    assert dataset.describe()["split"]["name"] == "faceformer"
    assert (ids(dataset, "train"), ids(dataset, "test")) == (["F2_e01"], ["F8_e38"])
    assert "does not say which emotion" in dataset.describe()["emotion_labels"]


def test_sounds_that_faceformers_vocaset_lacks_cost_their_sentences_alone(
    broken: Callable[[str], Path],
) -> None:
    folder = broken("vocaset-faceformer")
    lost = f"{SPEAKERS[0]}_sentence21"
    (folder / "wav" / f"{lost}.wav").unlink()
    out = packed(folder)
    assert excluded(out).keys() == {lost}
    assert f"its sound {folder / 'wav' / lost}.wav is missing" in excluded(out)[lost]
    assert ids(open_dataset(out), "train") == [f"{SPEAKERS[0]}_sentence01"]


# What is left out, and what stops


def forbidden(path: Path) -> None:
    path.write_bytes(pickle.dumps({"a": os.getcwd}))


def shorten(path: Path) -> None:
    wave, rate = soundfile.read(path, dtype="int16")
    soundfile.write(path, wave[: len(wave) // 3], rate)


def spoil(path: Path, frame: int = 6) -> None:
    motion = np.load(path)
    motion[frame].flat[7] = np.nan
    np.save(path, motion)


def drop_vertices(path: Path, count: int = 3) -> None:
    motion = np.load(path)
    np.save(path, motion[..., : -3 * count] if motion.ndim == 2 else motion[:, :-count])


def drop_template(folder: Path, speaker: str) -> None:
    listed = folder / "templates.pkl"
    if listed.is_file():
        content = pickle.loads(listed.read_bytes())
        del content[speaker]
        listed.write_bytes(pickle.dumps(content))
    else:
        next((folder / "templates").glob(f"{speaker}.*")).unlink()


def nothing(path: Path) -> None:
    np.save(path, np.load(path)[:0])


PAIRED = {  # layout -> speaker and stem of a training sequence, folder of its motion
    "vocaset-faceformer": (SPEAKERS[0], f"{SPEAKERS[0]}_sentence01", "vertices_npy"),
    "biwi": ("F1", "F1_01", "vertices"),
    "multiface": ("20171024", "20171024_SEN_hello", "vertices"),
    "emovoca": (SPEAKERS[0], f"{SPEAKERS[0]}_sentence01_Smile2_1", "sequences"),
    "folder": ("ann", "ann_1", "motion"),
    "landmarks": ("ann", "ann_1", "motion"),
}
FAULTS: dict[str, tuple[str, Callable[[Path], None], str]] = {
    "other vertices": ("motion", drop_vertices, r"points a frame, its mesh has"),
    "cut short": ("motion", lambda p: p.write_bytes(p.read_bytes()[:-100]), "cut short"),
    "no array": ("motion", lambda p: p.write_bytes(b"oops"), "no readable array"),
    "no frames": ("motion", nothing, "no frames|no readable array|motion is floating"),
    "not finite": ("motion", spoil, "frame 6 holds NaN or infinity"),
    "short sound": ("wav", shorten, r"its sound lasts .* its motion"),
    "no sound": ("wav", Path.unlink, r"its sound .*\.wav is missing"),
    "broken sound": ("wav", lambda p: p.write_bytes(b"RIFFoops"), r"\.wav"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", PAIRED)
def test_a_bad_take_is_left_out_and_the_others_go_on(
    broken: Callable[[str], Path], layouts: Path, name: str, fault: str
) -> None:
    folder = broken(name)
    _, stem, motion = PAIRED[name]
    where, spoils, reason = FAULTS[fault]
    path = (
        folder
        / (motion if where == "motion" else "wav")
        / f"{stem}.{'npy' if where == 'motion' else 'wav'}"
    )
    spoils(path)
    report = check_dataset(folder)
    out = packed(folder)
    found = excluded(out)
    assert found.keys() == report.excluded.keys() == {stem}
    import re

    assert re.search(reason, found[stem]), found[stem]
    manifest = json.loads((out / "manifest.json").read_text())
    whole = len(list((folder / motion).glob("*.npy")))
    assert len(manifest["sequences"]) == whole - 1
    assert check_dataset(out).excluded == found


def test_a_speaker_without_a_face_is_left_out(broken: Callable[[str], Path]) -> None:
    for name, (speaker, _, motion) in PAIRED.items():
        folder = broken(name)
        beside = folder.parent / "vocaset" if name == "emovoca" else folder
        drop_template(beside, speaker)
        out = import_dataset("auto", folder, folder.with_name(f"packed-{name}"))
        own = {p.stem for p in (folder / motion).glob(f"{speaker}*.npy")}
        assert excluded(out).keys() == own, name
        assert all(f"there is no neutral face of {speaker}" in r for r in excluded(out).values())


@pytest.mark.parametrize("name", ["vocaset", "vocaset-faceformer", "emovoca"])
def test_a_forbidden_class_in_the_templates_stops(broken: Callable[[str], Path], name: str) -> None:
    folder = broken(name)
    forbidden((folder.parent / "vocaset" if name == "emovoca" else folder) / "templates.pkl")
    with pytest.raises(UnsafePickleError, match=r"templates\.pkl .* posix\.getcwd"):
        packed(folder)
    assert not check_dataset(folder).ok


def test_faults_of_the_released_vocaset(broken: Callable[[str], Path]) -> None:
    folder = broken("vocaset")
    files = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}
    counter = iter(range(99))

    def outcome() -> dict[str, str]:
        out = import_dataset("vocaset", folder, folder.with_name(f"out{next(counter)}"))
        for name, content in files.items():
            (folder / name).write_bytes(content)
        return excluded(out)

    first = f"{SPEAKERS[0]}_sentence01"
    audio = pickle.loads(files["raw_audio_fixed.pkl"])
    entry = audio[SPEAKERS[0]]["sentence01"]
    entry["audio"] = entry["audio"][: len(entry["audio"]) // 3]
    del audio[SPEAKERS[0]]["sentence21"]
    (folder / "raw_audio_fixed.pkl").write_bytes(pickle.dumps(audio))
    found = outcome()
    assert found.keys() == {first, f"{SPEAKERS[0]}_sentence21"}
    assert "its sound lasts 0.34 s, its motion 1.03 s" in found[first]
    assert "no sound" in found[f"{SPEAKERS[0]}_sentence21"]
    spoil(folder / "data_verts.npy", frame=8)
    assert "frame 8 holds NaN" in outcome()[first]
    np.save(folder / "data_verts.npy", np.load(folder / "data_verts.npy")[:-40])
    found = outcome()
    assert found.keys() == {f"{SPEAKERS[2]}_sentence21"} and "cut short" in str(found)
    drop_template(folder, SPEAKERS[0])
    assert len(outcome()) == 2
    drop_vertices(folder / "data_verts.npy")
    with pytest.raises(DatasetError, match="5020 points a frame, its mesh has 5023"):
        outcome()
    for name in ("raw_audio_fixed.pkl", "subj_seq_to_idx.pkl"):
        (folder / "data_verts.npy").write_bytes(files["data_verts.npy"])
        forbidden(folder / name)
        with pytest.raises(UnsafePickleError, match=name.replace(".", r"\.")):
            outcome()
        (folder / name).write_bytes(files[name])
    (folder / "landmarks68.npy").unlink()
    with pytest.raises(MissingLandmarksError, match=r"FLAME .*68 landmarks.*freetalk mesh"):
        outcome()
    (folder / "subj_seq_to_idx.pkl").unlink()
    with pytest.raises(MissingFileError, match=r"lacks subj_seq_to_idx\.pkl"):
        outcome()


def test_faults_of_mead_emote(tmp_path: Path) -> None:
    folder = write_mead_emote(tmp_path / "mead")
    root = folder / "processed/reconstructions/EMICA-MEAD_flame2020"

    def take(name: str) -> Path:
        speaker, label, level = name.split("_")
        return root / speaker / "front" / label / f"level_{level}" / "001" / "shape_pose_cam.hdf5"

    with h5py.File(take("M003_angry_3"), "r+") as file:
        file["jaw"][0, 5, 1] = np.nan
    with h5py.File(take("M005_angry_3"), "r+") as file:
        del file["jaw"]
        file["jaw"] = np.zeros((1, 4, 3), np.float32)
    with h5py.File(take("M005_neutral_1"), "r+") as file:
        del file["exp"]
    # The first take of an actor, whose shape the neutral face would have: the next one's is taken.
    take("W009_angry_3").write_bytes(b"\x89HDF oops")
    shorten(folder / "processed/audio/W009/front/neutral/level_1/001.wav")
    (folder / "processed/audio/W011/front/neutral/level_1/001.wav").unlink()
    wrong = take("W011_angry_3").parent.parent
    wrong.rename(wrong.with_name("level_4"))
    out = import_dataset("MEAD-EMOTE", folder, tmp_path / "out")
    found = excluded(out)
    reasons = {
        "M003_angry_level_3_001": "frame 5 holds NaN",
        "M005_angry_level_3_001": "exp is (20, 100), jaw is (4, 3)",
        "M005_neutral_level_1_001": "lacks exp",
        "W009_angry_level_3_001": "no readable HDF5",
        "W009_neutral_level_1_001": "its sound lasts",
        "W011_neutral_level_1_001": "is missing",
        "W011_angry_level_4_001": "has the intensity '4'",
    }
    assert found.keys() == reasons.keys()
    for name, reason in reasons.items():
        assert reason in found[name]
    assert len(open_dataset(out).sequences()) == 5
    (folder / "flame.npz").unlink()
    with pytest.raises(MissingFileError, match=r"flame\.npz"):
        import_dataset("mead", folder, tmp_path / "other")


def test_labels_that_are_wrong_are_left_out(broken: Callable[[str], Path]) -> None:
    folder = broken("emovoca")
    stem = f"{SPEAKERS[0]}_sentence01_Smile2_1"
    np.save(folder / "label" / f"{stem}.npy", 3)
    assert "says 3, Smile2 is 4" in excluded(packed(folder))[stem]
    own = broken("folder")
    labels = (own / "labels.csv").read_text().replace("anger", "grumpy")
    (own / "labels.csv").write_text(labels.replace("hello there,val", "hello there,maybe"))
    found = excluded(packed(own))
    assert "the emotion 'grumpy'; known are neutral, afraid" in found["ann_1"]
    assert "the split 'maybe'; known: train, val, test" in found["bob_0"]
    assert len(found) == 5


def test_files_of_other_names_are_left_out_by_name(broken: Callable[[str], Path]) -> None:
    folder = broken("biwi")
    shutil.copy(folder / "vertices/F1_01.npy", folder / "vertices/test.npy")
    shutil.copy(folder / "vertices/F1_01.npy", folder / "vertices/F1_03.NPY")
    (folder / "wav/F1_02.wav").rename(folder / "wav/F1_02.WAV")
    out = packed(folder)
    assert excluded(out).keys() == {"test", "F1_03"}  # the latter has no sound
    assert "test is no name of biwi" in excluded(out)["test"]


def test_what_is_no_release_is_told(tmp_path: Path, layouts: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(LayoutError, match=r"no known dataset.*data_verts\.npy.*vertices_npy"):
        import_dataset("auto", tmp_path / "empty", tmp_path / "out")
    with pytest.raises(ValueError, match="no release 'voca'; known: vocaset, biwi"):
        import_dataset("voca", layouts / "vocaset", tmp_path / "out")
    with pytest.raises(MissingTemplateError, match="no neutral faces"):
        (tmp_path / "bare" / "motion").mkdir(parents=True)
        import_dataset("folder", tmp_path / "bare", tmp_path / "out")
    assert not check_dataset(tmp_path / "nowhere").ok
    folder = write_folder(tmp_path / "own")
    for path in (folder / "motion").iterdir():
        spoil(path)
    with pytest.raises(LayoutError, match=r"no usable take: .*holds NaN"):
        import_dataset("folder", folder, tmp_path / "out")
    assert not (tmp_path / "out").exists() and not check_dataset(folder).ok


# The command


def test_the_command_packs_tells_and_does_nothing_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_folder(tmp_path / "own")
    (folder / "wav" / "ann_0.wav").unlink()
    out = tmp_path / "packed"
    command = ["data", "import", "folder", str(folder), "--out", str(out), "--called", "MINE"]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "name: MINE" in printed and "left out: ann_0: its sound" in printed
    assert "emotions: neutral 2, angry 3, happy 3" in printed
    stamp = (out / "manifest.json").stat().st_mtime_ns
    assert main(command) == 0
    assert (out / "manifest.json").stat().st_mtime_ns == stamp
    # A take that was mended makes another dataset, which takes no other's place.
    soundfile.write(folder / "wav" / "ann_0.wav", sound(2, 16000, 0), 16000)
    assert main(command) == 2
    assert "holds another dataset: give another --out" in capsys.readouterr().err
    report = tmp_path / "report.json"
    assert main(["data", "check", str(out), "--json", str(report)]) == 0
    assert "ready to train" in capsys.readouterr().out
    assert json.loads(report.read_text())["excluded"].keys() == {"ann_0"}
    assert main(["data", "check", str(folder)]) == 0
    assert "ready for 'freetalk data import'" in capsys.readouterr().out


def test_multiface_of_a_template_that_nobody_knows_is_told(broken: Callable[[str], Path]) -> None:
    folder = broken("multiface")
    (folder / "mouth_indices.npy").unlink()
    report = check_dataset(packed(folder))
    assert any("lip_mask" in warning for warning in report.warnings)
    assert report.facts["template"] == "Multiface" and report.facts["vertices"] == MULTIFACE[0]
