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
from freetalk.data import DatasetError, import_dataset, open_dataset
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


def test_other_content_is_another_import(tmp_path: Path) -> None:
    directory = write_folder(tmp_path / "own", frames=20, fps=25)

    def raise_face(path: Path) -> None:
        vertices, faces = read_mesh(path)
        write_ply(path, vertices + np.float32([0, 0.001, 0]), faces)

    def relabel(path: Path) -> None:
        path.write_text(path.read_text().replace("ann,Happy", "ann,angry"))

    def lift(path: Path) -> None:
        motion = np.load(path)
        motion[3] += 0.001
        np.save(path, motion)
        os.utime(path)

    seen = [open_dataset(import_dataset("folder", directory, tmp_path / "0", name="own"))]
    for number, (name, change) in enumerate(
        (("templates/ann.ply", raise_face), ("labels.csv", relabel), ("motion/ann_1.npy", lift))
    ):
        changed_in_place(directory / name, change) if change is not lift else lift(directory / name)
        with pytest.raises(DatasetError, match="holds another dataset"):
            import_dataset("folder", directory, tmp_path / "0", name="own")
        out = import_dataset("folder", directory, tmp_path / f"{number + 1}", name="own")
        seen.append(open_dataset(out))
    assert len({dataset.fingerprint for dataset in seen}) == 4
    # Landmarks are displacements from the neutral face, which is 1 mm higher.
    first, second = (d.landmarks(d.sequences("train")[0]) for d in seen[:2])
    np.testing.assert_allclose((first - second)[..., 1], 0.001, atol=1e-6)


@pytest.mark.slow
def test_another_flame_is_another_import(tmp_path: Path) -> None:
    directory = write_mead_emote(tmp_path / "mead")
    before = import_dataset("mead", directory, tmp_path / "out")
    assert import_dataset("mead", directory, tmp_path / "out") == before
    (model,) = directory.rglob("flame.npz")

    def bend(path: Path) -> None:  # the bases alone: neutral faces stay
        arrays = dict(np.load(path))
        arrays["posedirs"] = 1.5 * arrays["posedirs"]
        np.savez(path, **arrays)

    changed_in_place(model, bend)
    with pytest.raises(DatasetError, match="holds another dataset"):
        import_dataset("mead", directory, tmp_path / "out")


def test_a_manifest_that_was_changed_is_another_dataset(tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "corpus")
    before = open_dataset(corpus).fingerprint
    path = corpus / "manifest.json"
    changed_in_place(
        path, lambda p: p.write_text(p.read_text().replace('"intensity": 2.0', '"intensity": 3.0'))
    )
    assert open_dataset(corpus).fingerprint != before
    assert open_dataset(write_mini_corpus(tmp_path / "other", 1)).fingerprint != before


def test_a_moved_corpus_is_the_same(tmp_path: Path) -> None:
    corpus = write_mini_corpus(tmp_path / "corpus")
    before = open_dataset(corpus).fingerprint
    shutil.move(corpus, tmp_path / "elsewhere")
    assert open_dataset(tmp_path / "elsewhere").fingerprint == before


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
