"""Fixtures of several test files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest


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
