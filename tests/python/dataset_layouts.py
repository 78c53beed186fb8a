"""Writes small datasets in exactly the layouts of the public ones, with motion that is known in closed form."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import soundfile
from scipy.spatial import Delaunay

from freetalk.corpus.assets import load_face_model
from freetalk.data import import_dataset
from freetalk.data.emotions import EMOVOCA_LABELS

FLAME, BIWI_6, MULTIFACE = (5023, 9976), (3895, 7539), (5471, 10837)
SPEAKERS = (
    "FaceTalk_170728_03272_TA", "FaceTalk_170811_03275_TA", "FaceTalk_170809_00138_TA",
)  # fmt: skip
"""One of VOCA's speakers of each split: train, val, test."""
RATE = 22000


@lru_cache
def face(num_vertices: int, num_faces: int) -> tuple[np.ndarray, np.ndarray]:
    """A dome of a face's size with exactly these counts: vertices (V, 3) m, triangles (F, 3).

    A Delaunay triangulation of V points with h on the hull has 2 V - 2 - h triangles.
    """
    hull = 2 * num_vertices - 2 - num_faces
    angle = 2 * np.pi * np.arange(hull) / hull
    inner = np.arange(num_vertices - hull)
    radius = 0.97 * np.sqrt((inner + 0.5) / len(inner))
    golden = np.pi * (3 - np.sqrt(5))
    x = np.concatenate([np.cos(angle), radius * np.cos(golden * inner)])
    y = np.concatenate([np.sin(angle), radius * np.sin(golden * inner)])
    faces = Delaunay(np.stack([x, y], axis=1)).simplices
    assert len(faces) == num_faces
    dome = np.stack([0.085 * x, 0.115 * y, 0.07 * (1 - 0.8 * (x**2 + y**2))], axis=1)
    a, b, c = (dome[faces[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a)[:, 2] > 0
    faces = np.where(outward[:, None], faces, faces[:, ::-1])
    return dome.astype(np.float32), faces.astype(np.int64)


def landmark_indices(vertices: np.ndarray) -> np.ndarray:
    """(68,) vertices under the built-in face's landmarks."""
    model = load_face_model()
    points = model.neutral[model.landmarks68][:, :2]
    distance = np.square(vertices[None, :, :2] - points[:, None]).sum(axis=-1)
    return distance.argmin(axis=1)


def neutral_of(speaker: str, size: tuple[int, int]) -> np.ndarray:
    """The neutral face of a speaker: the dome, a little wider or narrower."""
    vertices, _ = face(*size)
    stretch = 1 + 0.05 * np.sin(sum(map(ord, speaker)))
    return (vertices * np.float32([stretch, 1, 1])).astype(np.float32)


def motion_of(neutral: np.ndarray, frames: int, fps: float, seed: int) -> np.ndarray:
    """(T, V, 3) positions: the lower face opens and closes by millimetres, from rest."""
    times = np.arange(frames) / fps
    opening = 0.006 * np.square(np.sin(np.pi * (1.2 + 0.1 * (seed % 5)) * times))
    lower = np.exp(-np.square((neutral[:, 1] + 0.06) / 0.03)) * (neutral[:, 1] < -0.03)
    moved = np.repeat(neutral[None], frames, axis=0)
    moved[..., 1] -= (opening[:, None] * lower).astype(np.float32)
    return moved


def sound(seconds: float, rate: int, seed: int) -> np.ndarray:
    """(S,) int16 noise that comes and goes."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(seconds * rate)) / rate
    return (
        (6000 * np.sin(3 * times) * rng.standard_normal(len(times)))
        .clip(-32000, 32000)
        .astype("i2")
    )


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), dtype=[("n", "u1"), ("v", "<i4", 3)])
    rows["n"], rows["v"] = 3, faces
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(header.encode() + np.asarray(vertices, "<f4").tobytes() + rows.tobytes())


def write_lists(folder: Path, size: tuple[int, int], names: tuple[str, str, str]) -> None:
    """Landmarks and masks as the user brings them: landmarks, lips, upper face."""
    vertices, _ = face(*size)
    lips = np.flatnonzero(np.hypot(vertices[:, 0] / 0.03, (vertices[:, 1] + 0.045) / 0.02) < 1)
    np.save(folder / names[0], landmark_indices(vertices))
    np.save(folder / names[1], lips)
    np.save(folder / names[2], np.flatnonzero(vertices[:, 1] > 0.02))


def write_vocaset(folder: Path, sentences: tuple[int, ...] = (1, 21), frames: int = 61) -> Path:
    """VOCAset as released: one array of all frames, pickles of Python 2."""
    folder.mkdir(parents=True)
    rows: dict[str, Any] = {}
    audio: dict[str, Any] = {}
    parts, count = [], 0
    for speaker in SPEAKERS:
        for number in sentences:
            length = frames + number % 3
            parts.append(motion_of(neutral_of(speaker, FLAME), length, 60, number))
            name = f"sentence{number:02d}"
            rows.setdefault(speaker, {})[name] = {i: count + i for i in range(length)}
            samples = sound(length / 60, RATE, number)
            audio.setdefault(speaker, {})[name] = {"audio": samples, "sample_rate": RATE}
            count += length
    np.save(folder / "data_verts.npy", np.concatenate(parts).astype(np.float32))
    neutral = {speaker: neutral_of(speaker, FLAME).astype(np.float64) for speaker in SPEAKERS}
    for name, content in (
        ("subj_seq_to_idx", rows), ("raw_audio_fixed", audio), ("templates", neutral),
    ):  # fmt: skip
        (folder / f"{name}.pkl").write_bytes(pickle.dumps(content, protocol=2))
    write_ply(folder / "templates" / "FLAME_sample.ply", *face(*FLAME))
    write_lists(folder, FLAME, ("landmarks68.npy", "lip_mask.npy", "upper_mask.npy"))
    return folder


def write_faceformer(folder: Path, sentences: tuple[int, ...] = (1, 21), frames: int = 61) -> Path:
    """VOCAset as FaceFormer's script leaves it: 60 fps, flat rows."""
    for name in ("vertices_npy", "wav", "templates"):
        (folder / name).mkdir(parents=True)
    for speaker in SPEAKERS:
        for number in sentences:
            length, stem = frames + number % 3, f"{speaker}_sentence{number:02d}"
            moved = motion_of(neutral_of(speaker, FLAME), length, 60, number)
            np.save(folder / "vertices_npy" / f"{stem}.npy", moved.reshape(length, -1))
            soundfile.write(folder / "wav" / f"{stem}.wav", sound(length / 60, RATE, number), RATE)
    neutral = {speaker: neutral_of(speaker, FLAME).astype(np.float64) for speaker in SPEAKERS}
    (folder / "templates.pkl").write_bytes(pickle.dumps(neutral, protocol=2))
    write_ply(folder / "templates" / "FLAME_sample.ply", *face(*FLAME))
    write_lists(folder, FLAME, ("landmarks68.npy", "lip_mask.npy", "upper_mask.npy"))
    return folder


def write_scantalk(folder: Path, kind: str, frames: int = 40) -> Path:
    """BIWI_6 (millimetres, to try the units) or Multiface as ScanTalk keeps them."""
    size, fps, suffix = (BIWI_6, 25, ".obj") if kind == "biwi" else (MULTIFACE, 30, ".ply")
    speakers = ("F1", "F7", "F8") if kind == "biwi" else ("20171024", "20190828", "20181017")
    scale = np.float32(1000 if kind == "biwi" else 1)
    for name in ("vertices", "wav", "templates"):
        (folder / name).mkdir(parents=True)
    for index, speaker in enumerate(speakers):
        neutral = neutral_of(speaker, size)
        write = write_obj if suffix == ".obj" else write_ply
        write(folder / "templates" / f"{speaker}{suffix}", neutral * scale, face(*size)[1])
        stems = (
            [f"{speaker}_{n:02d}" for n in (1, 2)] if kind == "biwi" else [f"{speaker}_SEN_hello"]
        )
        for number, stem in enumerate(stems):
            moved = motion_of(neutral, frames, fps, number + index) * scale
            np.save(folder / "vertices" / f"{stem}.npy", moved)
            soundfile.write(
                folder / "wav" / f"{stem}.wav", sound(frames / fps, 16000, number), 16000
            )
    write_lists(folder, size, ("landmarks68.npy", "mouth_indices.npy", "upper_indices.npy"))
    return folder


def write_emovoca(folder: Path, labels: tuple[str, ...] = EMOVOCA_LABELS, frames: int = 30) -> Path:
    """EmoVOCA at 60 fps, a sentence for each emotion, templates in a ``vocaset`` beside it."""
    for name in ("sequences", "wav", "label", "intensity"):
        (folder / name).mkdir(parents=True)
    for speaker in SPEAKERS[:2]:
        for index, label in enumerate(labels):
            level = index % 3 + 1
            stem = f"{speaker}_sentence01_{label}_{level}"
            np.save(
                folder / "sequences" / f"{stem}.npy",
                motion_of(neutral_of(speaker, FLAME), frames, 60, index),
            )
            np.save(folder / "label" / f"{stem}.npy", EMOVOCA_LABELS.index(label))
            np.save(folder / "intensity" / f"{stem}.npy", level)
            soundfile.write(folder / "wav" / f"{stem}.wav", sound(frames / 60, RATE, index), RATE)
    beside = folder.parent / "vocaset"
    beside.mkdir(exist_ok=True)
    neutral = {speaker: neutral_of(speaker, FLAME) for speaker in SPEAKERS}
    (beside / "templates.pkl").write_bytes(pickle.dumps(neutral))
    write_ply(folder / "FLAME_sample.ply", *face(*FLAME))
    write_lists(folder, FLAME, ("landmarks68.npy", "lip_mask.npy", "upper_mask.npy"))
    return folder


def write_flame(path: Path, seed: int = 0) -> dict[str, np.ndarray]:
    """A model with FLAME's arrays and shapes, filled with smooth nonsense; returns the arrays."""
    rng = np.random.default_rng(seed)
    vertices, faces = face(*FLAME)
    jaw = 1 / (1 + np.exp((vertices[:, 1] + 0.03) / 0.01))
    weights = np.zeros((len(vertices), 5))
    weights[:, 2], weights[:, 1] = jaw, 1 - jaw
    regressor = rng.random((5, len(vertices)))
    arrays = {
        "v_template": vertices.astype(np.float64),
        "shapedirs": rng.normal(0, 1e-4, (len(vertices), 3, 400)).astype(np.float32),
        "posedirs": rng.normal(0, 1e-4, (len(vertices), 3, 36)).astype(np.float32),
        "J_regressor": regressor / regressor.sum(axis=1, keepdims=True),
        "weights": weights,
        "f": faces.astype(np.uint32),
    }
    np.savez(path, **arrays)
    return arrays


def write_mead_emote(folder: Path, frames: int = 20) -> Path:
    """MEAD as EMOTE's code writes it: HDF5 of FLAME's parameters at 25 fps below ``processed``."""
    rng = np.random.default_rng(3)
    root = folder / "processed"
    for actor in ("M003", "M005", "W009", "W011"):
        for label, level in (("neutral", 1), ("angry", 3), ("surprised", 2)):
            take = Path(actor) / "front" / label / f"level_{level}"
            target = root / "reconstructions" / "EMICA-MEAD_flame2020" / take / "001"
            target.mkdir(parents=True)
            with h5py.File(target / "shape_pose_cam.hdf5", "w") as file:
                file["shape"] = rng.normal(0, 1, (1, frames, 300)).astype(np.float32)
                file["exp"] = rng.normal(0, 1, (1, frames, 100)).astype(np.float32)
                file["jaw"] = np.abs(rng.normal(0, 0.1, (1, frames, 3))).astype(np.float32)
                file["global_pose"] = np.zeros((1, frames, 3), np.float32)
                file["cam"] = np.zeros((1, frames, 3), np.float32)
            wav = root / "audio" / take / "001.wav"
            wav.parent.mkdir(parents=True, exist_ok=True)
            soundfile.write(wav, sound(frames / 25, 16000, level), 16000)
    write_flame(folder / "flame.npz")
    write_lists(folder, FLAME, ("landmarks68.npy", "lip_mask.npy", "upper_mask.npy"))
    return folder


def write_folder(
    folder: Path,
    size: tuple[int, int] = (400, 760),
    frames: int = 60,
    sparse: bool = False,
    fps: int = 30,
) -> Path:
    """One's own recordings with labels; `sparse` has landmarks in place of vertices."""
    for name in ("motion", "wav", "templates"):
        (folder / name).mkdir(parents=True)
    vertices, faces = face(*size)
    indices = landmark_indices(vertices)
    rows = ["name,speaker,emotion,intensity,text,split"]
    for index, speaker in enumerate(("ann", "bob", "cleo")):
        neutral = neutral_of(speaker, size)
        if sparse:
            np.save(folder / "templates" / f"{speaker}.npy", neutral[indices])
        else:
            write_ply(folder / "templates" / f"{speaker}.ply", neutral, faces)
        for take, emotion in enumerate(("neutral", "anger", "Happy")):
            stem = f"{speaker}_{take}"
            moved = motion_of(neutral, frames, fps, index + take)
            np.save(
                folder / "motion" / f"{stem}.npy",
                (moved[:, indices] if sparse else moved).astype(np.float16 if take else np.float32),
            )
            seconds = frames / fps
            soundfile.write(folder / "wav" / f"{stem}.wav", sound(seconds, 16000, take), 16000)
            split = ("train", "val", "test")[index]
            rows.append(f"{stem},{speaker},{emotion},{1 + take},hello there,{split}")
    (folder / "labels.csv").write_text("\n".join(rows) + "\n")
    (folder / "dataset.json").write_text(json.dumps({"fps": fps, "unit": "m", "name": "own"}))
    if not sparse:
        (folder / "landmarks68.json").write_text(json.dumps({"landmarks": indices.tolist()}))
    return folder


def packed(directory: Path, **options: Any) -> Path:
    """What an import makes of a release, beside it."""
    return import_dataset(
        "auto", directory, directory.with_name(f"{directory.name}-packed"), **options
    )


Writer = Callable[[Path], Path]
WRITERS: dict[str, Writer] = {
    "vocaset": write_vocaset,
    "vocaset-faceformer": write_faceformer,
    "biwi": lambda path: write_scantalk(path, "biwi"),
    "multiface": lambda path: write_scantalk(path, "multiface"),
    "emovoca": lambda path: write_emovoca(path / "emovoca", ("Smile2", "Moody")),
    "mead-emote": write_mead_emote,
    "folder": write_folder,
    "landmarks": lambda path: write_folder(path, sparse=True),
}
"""Each layout and who writes it."""


def place(root: Path, name: str) -> Path:
    """The dataset of a layout below a folder of all."""
    return root / name / "emovoca" if name == "emovoca" else root / name
