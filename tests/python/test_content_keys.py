"""What is kept on disk is found again by its content, and counts only once it is on the disk."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_layouts import write_folder, write_mead_emote, write_ply
from mini_corpus import write_mini_corpus

from freetalk._files import content_hash, replacing, write_text
from freetalk._pretrained import PRETRAINED
from freetalk.data import OpenCorpus, open_dataset
from freetalk.data.landmark_cache import LandmarkCache
from freetalk.data.templates import read_mesh
from freetalk.tables.definitions import Recipes
from freetalk.tables.sets import Catalogue
from freetalk.tables.sizes import TINY

pytestmark = pytest.mark.usefixtures("own_cache")


def changed_in_place(path: Path, change: Callable[[Path], None]) -> None:
    """Writes another content of the same time of change, as a copy that keeps times does."""
    state = path.stat()
    change(path)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


def test_another_neutral_face_is_another_dataset(tmp_path: Path) -> None:
    directory = write_folder(tmp_path / "own", frames=20, fps=25)
    before = open_dataset(directory)
    landmarks = before.landmarks(before.sequences("train")[0])
    meshes = sorted((directory / "templates").glob("*.ply"))
    assert meshes

    def raise_face(path: Path) -> None:
        vertices, faces = read_mesh(path)
        write_ply(path, vertices + np.float32([0, 0.001, 0]), faces)

    for mesh in meshes:
        changed_in_place(mesh, raise_face)
    after = open_dataset(directory)
    assert after.fingerprint != before.fingerprint
    # Landmarks are displacements from the neutral face, which is 1 mm higher; the cache must not answer.
    moved = landmarks - after.landmarks(after.sequences("train")[0])
    np.testing.assert_allclose(moved[..., 1], 0.001, atol=1e-6)


def test_another_flame_is_another_dataset(tmp_path: Path) -> None:
    directory = write_mead_emote(tmp_path / "mead")
    before = open_dataset(directory).fingerprint
    assert open_dataset(directory).fingerprint == before
    (model,) = directory.rglob("flame.npz")

    def bend(path: Path) -> None:  # the bases alone: neutral faces stay
        arrays = dict(np.load(path))
        arrays["posedirs"] = 1.5 * arrays["posedirs"]
        np.savez(path, **arrays)

    changed_in_place(model, bend)
    assert open_dataset(directory).fingerprint != before


@pytest.mark.parametrize("name", ["landmarks.npy", "weights.npy", "manifest.json", "fine.npz"])
def test_another_content_is_another_corpus(name: str, tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "corpus")
    before = OpenCorpus(corpus).fingerprint
    (path,) = corpus.rglob(name)

    def change(file: Path) -> None:
        if file.suffix == ".npy":
            array = np.load(file)
            array[0] += 0.001
            np.save(file, array)
        elif file.suffix == ".json":
            file.write_text(file.read_text().replace('"intensity": 2.0', '"intensity": 3.0'))
        else:
            arrays = dict(np.load(file))
            arrays["lip_mask"] = ~arrays["lip_mask"]
            np.savez(file, **arrays)

    changed_in_place(path, change)
    assert OpenCorpus(corpus).fingerprint != before


def test_a_moved_corpus_is_the_same(tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "corpus")
    before = OpenCorpus(corpus).fingerprint
    shutil.move(corpus, tmp_path / "elsewhere")
    assert OpenCorpus(tmp_path / "elsewhere").fingerprint == before


def test_another_encoder_is_another_training(tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "corpus")
    catalogue = Catalogue([f"VOCASET={corpus}"], {})
    encoder = tmp_path / "speech"
    shutil.copytree(PRETRAINED / "open-small" / "speech", encoder)
    recipes = Recipes(TINY, 0, [f"ats.task.speech_encoder={encoder}"])
    before = recipes.ats(("VOCASET",)).key(catalogue)
    assert recipes.ats(("VOCASET",)).key(catalogue) == before
    stm = recipes.stm(("VOCASET",)).key(catalogue)

    def flip(path: Path) -> None:
        content = bytearray(path.read_bytes())
        content[-1] ^= 1
        path.write_bytes(bytes(content))

    flip(encoder / "model.safetensors")
    assert recipes.ats(("VOCASET",)).key(catalogue) != before
    assert recipes.stm(("VOCASET",)).key(catalogue) == stm  # it hears nothing


def test_landmarks_are_on_the_disk_before_they_are_marked(tmp_path: Path) -> None:
    cache = LandmarkCache(tmp_path, 8, 2)
    flushed: list[tuple[float, int]] = []
    real = cache._landmarks.flush

    def flush() -> None:
        flushed.append((float(cache._landmarks[4, 0, 0]), int(cache._done[1])))
        real()

    cache._landmarks.flush = flush  # type: ignore[method-assign]
    cache.get(1, 4, 4, lambda: np.full((4, 68, 3), 2.0, np.float32))
    assert flushed == [(2.0, 0)]
    assert cache._done[1] == 1
    with pytest.raises(RuntimeError, match="no landmarks"):

        def fail() -> np.ndarray:
            raise RuntimeError("no landmarks")

        cache.get(0, 0, 4, fail)
    assert cache._done[0] == 0


def test_a_writer_that_fails_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "one.txt"
    write_text(path, "old")
    with pytest.raises(RuntimeError, match="halfway"), replacing(path) as temporary:
        temporary.write_text("ne")
        raise RuntimeError("halfway")
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == ["one.txt"]


def test_a_file_is_flushed_before_it_takes_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[bool, bool]] = []
    real = os.fsync
    path = tmp_path / "one.json"

    def fsync(descriptor: int) -> None:
        target = Path(f"/proc/self/fd/{descriptor}").readlink()
        seen.append((target.is_dir(), path.exists()))
        real(descriptor)

    monkeypatch.setattr(os, "fsync", fsync)
    write_text(path, "{}")
    assert seen == [(False, False), (True, True)]  # the content, then the name


def test_hashes_are_of_content_and_names(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "one").write_text("1")
        (tmp_path / folder / "two").write_text("2")
    assert content_hash(tmp_path / "a") == content_hash(tmp_path / "b")
    (tmp_path / "b" / "one").rename(tmp_path / "b" / "three")
    assert content_hash(tmp_path / "a") != content_hash(tmp_path / "b")
    with pytest.raises(OSError, match="lost"):
        content_hash(tmp_path / "lost")
