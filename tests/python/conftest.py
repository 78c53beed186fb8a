"""Fixtures of several test files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

#: Files whose tests train networks, build corpora, install the package, render or open a browser. The rest is
#: the quick subset, ``pytest -m "not slow"``; single slow tests elsewhere carry the mark themselves.
SLOW_FILES = {
    "test_corpus",
    "test_corpus_codes",
    "test_corpus_topologies",
    "test_data_training",
    "test_demo",
    "test_devices",
    "test_evaluate",
    "test_faces",
    "test_head",
    "test_head_fit",
    "test_install",
    "test_landmark_follower",
    "test_nasty_meshes",
    "test_package",
    "test_page_browser",
    "test_pretrained",
    "test_rig",
    "test_serve_browser",
    "test_stubs",
    "test_tables",
    "test_train",
    "test_train_checkpoint",
    "test_train_cuts",
    "test_train_diffusion_steps",
    "test_train_features",
    "test_train_head",
    "test_train_initial",
    "test_train_mosaic",
    "test_train_previews",
    "test_train_processes",
    "test_train_recordings",
    "test_viseme_probe",
    "test_viz",
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks the tests of ``SLOW_FILES``."""
    for item in items:
        if item.path.stem in SLOW_FILES:
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keeps what datasets leave in the user's folders below the test's own."""
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("FREETALK_TEMPLATES", str(tmp_path / "templates"))


@pytest.fixture(scope="session")
def layouts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of each layout; not to be written to."""
    from dataset_layouts import WRITERS  # here, so that tests without datasets import nothing

    root = tmp_path_factory.mktemp("layouts")
    for name, write in WRITERS.items():
        write(root / name)
    return root


@pytest.fixture
def broken(layouts: Path, tmp_path: Path) -> Callable[[str], Path]:
    """A copy of a layout to break."""

    from dataset_layouts import place

    def copy(name: str) -> Path:
        shutil.copytree(layouts / name, tmp_path / name)
        return place(tmp_path, name)

    return copy
