"""Templates: lists of vertices in any file, units, FLAME, splits, landmarks proposed for a new meshing."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from dataset_layouts import (
    face,
    landmark_indices,
    packed,
    write_flame,
    write_folder,
    write_ply,
)

from freetalk.cli.app import main
from freetalk.corpus import emotion as corpus_emotion
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.data import (
    EMOTIONS,
    DatasetError,
    LabelError,
    UnsafePickleError,
    VertexCountError,
    index_hash,
    open_dataset,
    read_landmarks,
    read_mask,
)
from freetalk.data.emotions import EMOVOCA_LABELS, LABELS, SYNONYMS, emotion_of, intensity_of
from freetalk.data.flame import read_flame
from freetalk.data.landmark_transfer import LinearFace, fit_face, propose_landmarks, region_masks
from freetalk.data.pose import find_pose
from freetalk.data.splits import SCHEMES, schemes_of

pytestmark = pytest.mark.usefixtures("own_cache")
SIZE = (400, 760)
LIPS = np.array([7, 3, 12, 399])

MASK_FILES: dict[str, Callable[[Path], Any]] = {
    "lips.npy": lambda p: np.save(p, LIPS),
    "lips.txt": lambda p: p.write_text("# lips\n7, 3\n12;399\n"),
    "lips.json": lambda p: p.write_text(json.dumps(LIPS.tolist())),
    "lips.mat": lambda p: scipy.io.savemat(p, {"lips_idx": LIPS[:, None] + 1}),
    "lips.pkl": lambda p: p.write_bytes(pickle.dumps({"lips": LIPS, "nose": np.array([1])}, 2)),
    "flags.npy": lambda p: np.save(p, np.isin(np.arange(400), LIPS)),
    "floats.npy": lambda p: np.save(p, LIPS.astype(np.float64)),
}


@pytest.mark.parametrize("name", MASK_FILES)
def test_a_mask_is_the_same_from_any_file(tmp_path: Path, name: str) -> None:
    MASK_FILES[name](tmp_path / name)
    mask = read_mask(tmp_path / name, 400, ("lips",))
    np.testing.assert_array_equal(mask.indices, np.sort(LIPS))
    described = {"source": str(tmp_path / name), "count": 4, "sha256": index_hash(np.sort(LIPS))}
    assert mask.describe() == described


def test_lists_of_another_mesh_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "lips.npy", LIPS)
    with pytest.raises(VertexCountError, match="vertices from 3 to 399, the template has 399"):
        read_mask(tmp_path / "lips.npy", 399)
    np.save(tmp_path / "half.npy", LIPS + 0.5)
    with pytest.raises(DatasetError, match="whole numbers"):
        read_mask(tmp_path / "half.npy", 400)
    np.save(tmp_path / "few.npy", np.arange(51))
    with pytest.raises(DatasetError, match="names 51 landmarks; expected 68"):
        read_landmarks(tmp_path / "few.npy", face(*SIZE)[1], 400)
    (tmp_path / "other.json").write_text(json.dumps({"landmarks": [0] * 68, "vertices": 5023}))
    with pytest.raises(VertexCountError, match="a mesh with 5023 vertices"):
        read_landmarks(tmp_path / "other.json", face(*SIZE)[1], 400)
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps({"lips": Path("x")}))
    with pytest.raises(UnsafePickleError, match=r"bad\.pkl"):
        read_mask(tmp_path / "bad.pkl", 400)


NAMES = ["embedding.pkl", "landmark_embedding.npy", "flame_static_embedding.pkl"]


@pytest.mark.parametrize("name", NAMES)
def test_barycentric_landmarks_lie_on_their_faces(tmp_path: Path, name: str) -> None:
    vertices, faces = face(*SIZE)
    rng = np.random.default_rng(0)
    rows, weights = rng.integers(0, len(faces), 68), rng.dirichlet([1, 1, 1], 68)
    if name.startswith("flame"):
        jaw = {"lmk_face_idx": np.stack([rows[:17]] * 3), "lmk_b_coords": weights[None, :17]}
        np.save(tmp_path / "flame_dynamic_embedding.npy", np.array(jaw, dtype=object))
        content = {"lmk_face_idx": rows[17:], "lmk_b_coords": weights[17:]}
        (tmp_path / name).write_bytes(pickle.dumps(content, protocol=2))
    elif name.endswith("pkl"):
        content = {"lmk_face_idx": rows.astype(np.uint32), "lmk_b_coords": weights}
        (tmp_path / name).write_bytes(pickle.dumps(content, protocol=2))
    else:  # as DECA keeps it: a mapping inside an array of objects
        content = {"full_lmk_faces_idx": rows[None], "full_lmk_bary_coords": weights[None]}
        np.save(tmp_path / name, np.array(content, dtype=object), allow_pickle=True)
    marks = read_landmarks(tmp_path / name, faces, len(vertices))
    brute = [sum(w * vertices[v] for w, v in zip(weights[i], faces[rows[i]])) for i in range(68)]
    np.testing.assert_allclose(marks.of(vertices), brute, atol=1e-8)  # float32 of a decimetre
    moved = np.stack([vertices, vertices + 1])
    np.testing.assert_allclose(marks.of(moved)[1] - marks.of(moved)[0], 1, atol=1e-6)
    assert marks.describe()["count"] == 68


def test_hashes_tell_order_and_content_apart() -> None:
    assert index_hash(np.array([1, 2])) == index_hash(np.array([1, 2], dtype=np.uint8))
    assert len({index_hash(np.array(x)) for x in ([1, 2], [2, 1], [1, 3], [1])}) == 4


@pytest.mark.parametrize(
    ("unit", "scale"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)]
)
def test_the_unit_is_told_from_the_eyes(unit: str, scale: float) -> None:
    vertices, _ = face(*SIZE)
    marks = vertices[landmark_indices(vertices)]
    pose = find_pose([vertices / scale], [marks / scale])
    assert (pose.unit, pose.scale) == (unit, scale)
    normalised = find_pose([vertices * 11], [marks * 11])  # a head of two and a half metres, or ...
    assert normalised.unit == "normalised"
    eyes = normalised.apply(marks * 11)
    assert np.linalg.norm(eyes[36] - eyes[45]) == pytest.approx(0.088, rel=1e-5)
    with pytest.raises(DatasetError, match="'ft' is none of m, cm, mm, in"):
        find_pose([vertices], [marks], "ft")


def test_what_flame_lacks_is_named(tmp_path: Path) -> None:
    arrays = write_flame(tmp_path / "flame.npz")
    assert read_flame(tmp_path / "flame.npz").arrays(50)["expression_basis"].shape == (59, 5023, 3)
    with pytest.raises(DatasetError, match="has 100 expressions, the takes 101"):
        read_flame(tmp_path / "flame.npz").arrays(101)
    arrays.pop("posedirs")
    np.savez(tmp_path / "flame.npz", **arrays)
    with pytest.raises(DatasetError, match="lacks posedirs"):
        read_flame(tmp_path / "flame.npz")


def test_splits_have_the_papers_sizes() -> None:
    for kind, sizes in (
        ("vocaset", (8, 2, 2)), ("emovoca", (8, 2, 2)), ("biwi", (10, 2, 2)), ("multiface", (9, 2, 2)),
    ):  # fmt: skip
        assert tuple(len(v) for v in SCHEMES[kind][0].speakers.values()) == sizes
    actors = [f"M{n:03d}" for n in range(3, 30)] + [f"W{n:03d}" for n in range(9, 29)]
    first, emote = schemes_of("mead", actors)
    drawn = first.speakers
    assert tuple(len(v) for v in drawn.values()) == (36, 5, 6)
    assert sorted(sum(drawn.values(), ())) == actors
    assert drawn == schemes_of("mead", actors[::-1])[0].speakers
    assert (first.name, emote.name) == ("freetalk", "emote")
    assert emote.of("M003") == emote.of("W009") == "train"
    assert emote.of("M029") == emote.of("W028") == "test"
    voca = SCHEMES["vocaset"][0]
    assert voca.of("FaceTalk_170811_03275_TA", 20) is None
    assert voca.of("FaceTalk_170811_03275_TA", 21) == "val"
    assert voca.of("nobody", 1) is None


def test_one_vocabulary_serves_model_corpus_and_datasets() -> None:
    assert corpus_emotion.EMOTIONS == EMOTIONS
    assert set(corpus_emotion.POSES) == set(EMOTIONS)
    assert set(SYNONYMS.values()) <= set(EMOTIONS)
    for table in LABELS.values():
        assert set(table.values()) <= set(EMOTIONS)
        assert len(set(table.values())) == len(table)  # no two labels fall together
    assert set(EMOVOCA_LABELS) == set(LABELS["emovoca"])
    assert emotion_of(" Fear ") == "afraid"
    with pytest.raises(LabelError, match="'bored'"):
        emotion_of("bored")
    for wrong in ("0", "4", "high", None):
        with pytest.raises(LabelError, match="from 1 to 3"):
            intensity_of(wrong)


@pytest.fixture(scope="module")
def stranger() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A head that the built-in face's mean is not: vertices (V, 3) m, triangles, true landmarks."""
    model = load_face_model()
    count = EXTENTS["head"]
    modes = model.identity_basis[:, :count]
    drawn = np.random.default_rng(8).standard_normal(len(modes))
    vertices = model.neutral[:count] + np.tensordot(drawn, modes, axes=1)
    return vertices, triangulate(crop_quads(model, "head")), model.landmarks68


def test_proposed_landmarks_are_within_millimetres(
    stranger: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    vertices, faces, true = stranger
    model, count = load_face_model(), EXTENTS["face"]
    triangles = triangulate(crop_quads(model, "face"))
    # Half of the modes: the face is outside of what can be fitted, as that of another template is.
    modes = model.identity_basis[:50, :count]
    known = LinearFace(model.neutral[:count], triangles, modes, model.landmarks68)
    proposed = propose_landmarks(vertices, faces, known)
    error = np.linalg.norm(proposed.positions - vertices[true], axis=1)
    mean = model.neutral[model.landmarks68]
    unfitted = np.linalg.norm(mean - vertices[true], axis=1)
    assert error.mean() < 0.0015  # about the distance of neighbouring vertices
    assert error.mean() < 0.3 * unfitted.mean()
    assert error[48:].max() < 0.005
    lips, upper = region_masks(vertices, proposed.indices, proposed.fit)
    assert 100 < len(lips) < len(upper)
    assert not set(lips) & set(upper)
    assert set(proposed.indices[60:]) <= set(lips)
    with pytest.raises(ValueError, match="hardly meet"):
        fit_face(vertices + 0.5, faces, known)


@pytest.mark.slow
def test_the_command_writes_landmarks_that_a_dataset_reads(
    stranger: tuple[np.ndarray, np.ndarray, np.ndarray],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    vertices, faces, true = stranger
    write_ply(tmp_path / "head.ply", 1000 * vertices, faces)
    out, picture = tmp_path / "landmarks68.json", tmp_path / "l.png"
    command = ["mesh", "landmarks", str(tmp_path / "head.ply"), "--out", str(out)]
    assert main([*command, "--picture", str(picture), "--masks"]) == 0
    assert "unit mm" in capsys.readouterr().out
    found = read_landmarks(out, faces, len(vertices)).indices
    assert np.linalg.norm(vertices[found] - vertices[true], axis=1).mean() < 0.001
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert read_mask(tmp_path / "lip_mask.json", len(vertices)).indices.size > 100
    assert main([*command, "--start", str(out), "--set", "48=17", "--set", "3=5"]) == 0
    changed = read_landmarks(out, faces, len(vertices)).indices
    assert (changed[48], changed[3]) == (17, 5)
    assert (np.delete(changed, [3, 48]) == np.delete(found, [3, 48])).all()
    assert main([*command, "--set", "68=1"]) == 2
    assert "landmarks are 0 to 67" in capsys.readouterr().err


def test_the_users_own_files_serve_every_dataset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_folder(tmp_path / "own")
    home = tmp_path / "mine" / "folder"
    home.mkdir(parents=True)
    (folder / "landmarks68.json").rename(home / "landmarks.json")
    (home / "lip_mask.txt").write_text("7 3 12 399")
    monkeypatch.setenv("FREETALK_TEMPLATES", str(tmp_path / "mine"))
    described = open_dataset(packed(folder)).describe()
    assert described["landmarks"]["source"] == str(home / "landmarks.json")
    assert described["lip_mask"]["sha256"] == index_hash(np.sort(LIPS))
    assert described["upper_face_mask"] is None
