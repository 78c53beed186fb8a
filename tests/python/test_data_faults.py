"""Each way to break a dataset gives an error with a name, which says where and what to do."""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile
from dataset_layouts import (
    SPEAKERS,
)

from freetalk.data import (
    DatasetError,
    LabelError,
    LayoutError,
    MissingFileError,
    MissingLandmarksError,
    MissingTemplateError,
    NotFiniteError,
    ShortAudioError,
    UnsafePickleError,
    VertexCountError,
    check_dataset,
    open_dataset,
)

pytestmark = pytest.mark.usefixtures("own_cache")


def forbidden(path: Path, content: object = None) -> None:
    path.write_bytes(pickle.dumps({"a": os.getcwd, "b": content}))


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


PAIRED = {  # layout -> speaker and stem of a training sequence, folder of its motion
    "vocaset-faceformer": (SPEAKERS[0], f"{SPEAKERS[0]}_sentence01", "vertices_npy"),
    "biwi": ("F1", "F1_01", "vertices"),
    "multiface": ("20171024", "20171024_SEN_hello", "vertices"),
    "emovoca": (SPEAKERS[0], f"{SPEAKERS[0]}_sentence01_Smile2_1", "sequences"),
    "folder": ("ann", "ann_1", "motion"),
    "landmarks": ("ann", "ann_1", "motion"),
}


@pytest.mark.parametrize("name", PAIRED)
def test_each_fault_of_a_paired_layout_has_its_name(
    broken: Callable[[str], Path], name: str
) -> None:
    folder = broken(name)
    speaker, stem, motion = PAIRED[name]
    beside = folder.parent / "vocaset" if name == "emovoca" else folder
    templates = {p: p.read_bytes() for p in beside.glob("templates*/*.*")}
    templates |= {p: p.read_bytes() for p in beside.glob("templates.pkl")}
    drop_template(beside, speaker)
    with pytest.raises(MissingTemplateError, match=f"motion of {speaker}, but no neutral face"):
        open_dataset(folder)
    for path, content in templates.items():
        path.write_bytes(content)

    moved, wav = folder / motion / f"{stem}.npy", folder / "wav" / f"{stem}.wav"
    content, sound = moved.read_bytes(), wav.read_bytes()
    drop_vertices(moved)
    with pytest.raises(
        VertexCountError, match=rf"{stem}\.npy has \d+ points a frame, its mesh has"
    ):
        open_dataset(folder)
    moved.write_bytes(content[:-100])
    with pytest.raises(DatasetError, match=rf"{stem}\.npy has \d+ bytes, .* cut short"):
        open_dataset(folder)
    moved.write_bytes(content)

    shorten(wav)
    with pytest.raises(ShortAudioError, match=rf"{stem}\.wav lasts .* its motion"):
        open_dataset(folder)
    wav.unlink()
    with pytest.raises(MissingFileError, match=rf"{stem} has no sound: .*{stem}\.wav is missing"):
        open_dataset(folder)
    wav.write_bytes(sound)

    spoil(moved)
    dataset = open_dataset(folder)
    sequence = next(s for s in dataset.sequences() if s.id == stem)
    frame = 6 // (2 if dataset.describe()["decimated"] == 2 else 1)
    with pytest.raises(NotFiniteError, match=f"sequence {stem}, frame {frame} .* NaN"):
        dataset.landmarks(sequence)
    report = check_dataset(folder)
    assert not report.ok
    assert any(f"frame {frame}" in error for error in report.errors)


@pytest.mark.parametrize("name", ["vocaset", "vocaset-faceformer", "emovoca"])
def test_a_forbidden_class_in_the_templates_is_named(
    broken: Callable[[str], Path], name: str
) -> None:
    folder = broken(name)
    beside = folder.parent / "vocaset" if name == "emovoca" else folder
    forbidden(beside / "templates.pkl")
    with pytest.raises(UnsafePickleError, match=r"templates\.pkl .* posix\.getcwd"):
        open_dataset(folder)


def test_each_fault_of_the_released_vocaset_has_its_name(broken: Callable[[str], Path]) -> None:
    folder = broken("vocaset")
    files = {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}

    def mended() -> None:
        for name, content in files.items():
            (folder / name).write_bytes(content)

    drop_template(folder, SPEAKERS[0])
    with pytest.raises(MissingTemplateError, match=f"motion of {SPEAKERS[0]}, but no neutral face"):
        open_dataset(folder)
    mended()
    for name in ("raw_audio_fixed.pkl", "subj_seq_to_idx.pkl"):
        forbidden(folder / name)
        with pytest.raises(UnsafePickleError, match=name.replace(".", r"\.")):
            open_dataset(folder)
        mended()
    audio = pickle.loads(files["raw_audio_fixed.pkl"])
    entry = audio[SPEAKERS[0]]["sentence01"]
    entry["audio"] = entry["audio"][: len(entry["audio"]) // 3]
    (folder / "raw_audio_fixed.pkl").write_bytes(pickle.dumps(audio))
    with pytest.raises(ShortAudioError, match=r"sentence01\.wav lasts 0\.34 s, its motion 1\.0"):
        open_dataset(folder)
    mended()
    drop_vertices(folder / "data_verts.npy")
    with pytest.raises(VertexCountError, match="has 5020 points a frame, FLAME has 5023"):
        open_dataset(folder)
    mended()
    np.save(folder / "data_verts.npy", np.load(folder / "data_verts.npy")[:-40])
    with pytest.raises(LayoutError, match=r"data_verts\.npy has .* cut short"):
        open_dataset(folder)
    mended()
    spoil(folder / "data_verts.npy", frame=8)
    dataset = open_dataset(folder)
    with pytest.raises(NotFiniteError, match=f"sequence {SPEAKERS[0]}_sentence01, frame 4 "):
        dataset.landmarks(dataset.sequences("train")[0])
    mended()
    (folder / "subj_seq_to_idx.pkl").unlink()
    with pytest.raises(MissingFileError, match=r"lacks subj_seq_to_idx\.pkl"):
        open_dataset(folder)
    mended()
    (folder / "landmarks68.npy").unlink()
    with pytest.raises(MissingLandmarksError, match=r"FLAME .*68 landmarks.*freetalk mesh"):
        open_dataset(folder).check()


def test_each_fault_of_mead_emote_has_its_name(broken: Callable[[str], Path]) -> None:
    import h5py

    folder = broken("mead-emote")
    take = "M003/front/angry/level_3/001"
    target = (
        folder / "processed/reconstructions/EMICA-MEAD_flame2020" / take / "shape_pose_cam.hdf5"
    )
    wav = folder / "processed/audio" / f"{take}.wav"
    content, sound = target.read_bytes(), wav.read_bytes()
    with h5py.File(target, "r+") as file:
        file["jaw"][0, 5, 1] = np.nan
    dataset = open_dataset(folder, split="emote")
    sequence = next(s for s in dataset.sequences() if s.id == "M003_angry_level_3_001")
    with pytest.raises(NotFiniteError, match="sequence M003_angry_level_3_001, frame 5 "):
        dataset.landmarks(sequence)
    with h5py.File(target, "r+") as file:
        del file["jaw"]
        file["jaw"] = np.zeros((1, 4, 3), np.float32)
    with pytest.raises(VertexCountError, match=r"exp is \(20, 100\), jaw is \(4, 3\)"):
        open_dataset(folder)
    target.write_bytes(content[: len(content) // 2])
    with pytest.raises(DatasetError, match="no readable HDF5"):
        open_dataset(folder)
    target.write_bytes(content)
    shorten(wav)
    with pytest.raises(ShortAudioError, match=r"001\.wav lasts"):
        open_dataset(folder)
    wav.write_bytes(sound)
    target.parent.parent.rename(target.parent.parent.with_name("level_4"))
    with pytest.raises(LabelError, match="has the intensity '4'"):
        open_dataset(folder)
    (folder / "flame.npz").unlink()
    with pytest.raises(MissingFileError, match=r"flame\.npz"):
        open_dataset(folder)


def test_label_files_that_contradict_the_name_are_refused(broken: Callable[[str], Path]) -> None:
    folder = broken("emovoca")
    stem = f"{SPEAKERS[0]}_sentence01_Smile2_1"
    np.save(folder / "label" / f"{stem}.npy", 3)
    with pytest.raises(LabelError, match="says 3, Smile2 is 4"):
        open_dataset(folder)
    own = broken("folder")
    labels = (own / "labels.csv").read_text().replace("anger", "grumpy")
    (own / "labels.csv").write_text(labels)
    with pytest.raises(LabelError, match="the emotion 'grumpy'; known are neutral, afraid"):
        open_dataset(own)


def test_a_check_tells_every_fault_at_once(broken: Callable[[str], Path]) -> None:
    folder = broken("biwi")
    shorten(folder / "wav" / "F1_01.wav")
    spoil(folder / "vertices" / "F7_01.npy")
    drop_vertices(folder / "vertices" / "F8_02.npy")
    (folder / "mouth_indices.npy").unlink()
    report = check_dataset(folder)
    assert len(report.errors) == 3
    for named in ("F1_01.wav lasts", "F7_01, frame 6", "F8_02.npy has 3892 points"):
        assert any(named in error for error in report.errors)
    assert any("lip_mask" in warning for warning in report.warnings)
    assert any("F8_02" in e or "F1_01" in e for e in check_dataset(folder, quick=True).errors)
