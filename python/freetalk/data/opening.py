"""Opens packed datasets by their paths, one or several with names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from freetalk.data.dataset import Dataset
from freetalk.data.errors import LayoutError, MissingFileError
from freetalk.data.pack import Pack


def parse_spec(spec: str) -> tuple[str, str, str]:
    """Takes ``NAME=PATH``, ``NAME:SPLIT=PATH`` or a plain path apart.

    Returns:
        name (empty for a plain path), split scheme (empty for the default), path.
    """
    name, equals, path = spec.partition("=")
    if not equals or "/" in name or Path(spec).exists():
        return "", "", spec
    name, _, split = name.partition(":")
    return name, split, path


def open_dataset(path: str | Path, *, name: str = "", split: str = "") -> Dataset:
    """Opens what ``freetalk data import`` or ``freetalk corpus build`` wrote.

    Args:
        path: its folder.
        name: what results call it; by default as it calls itself.
        split: name of the split scheme; empty for the dataset's first.

    Raises:
        MissingFileError, LayoutError: no folder; not packed, with the command that packs it.
        DatasetError: a file disagrees with the manifest, or an unknown split.
    """
    directory = Path(path)
    if not directory.is_dir():
        raise MissingFileError(f"{directory} is no folder")
    if not (directory / "manifest.json").is_file():
        from freetalk.data.releases import kind_of

        raise LayoutError(
            f"{directory} is not packed: run 'freetalk data import {kind_of(directory)} {directory} --out DIR' "
            "once, and give DIR"
        )
    return Dataset(Pack(directory), name, split)


def open_datasets(specs: str | Path | Iterable[str | Path]) -> Dataset:
    """Opens one dataset, or a mixture of several.

    Args:
        specs: one or several of ``PATH``, ``NAME=PATH``, ``NAME:SPLIT=PATH``.

    Raises:
        DatasetError: what is missing or wrong, by name.
        ValueError: no dataset, or two of one name.
    """
    given = [specs] if isinstance(specs, str | Path) else list(specs)
    if not given:
        raise ValueError("no dataset is given")
    parts: dict[str, Dataset] = {}
    for spec in given:
        name, split, path = parse_spec(str(spec))
        dataset = open_dataset(path, name=name, split=split)
        if dataset.name in parts:
            raise ValueError(f"two datasets are called {dataset.name}; give them names: NAME=PATH")
        parts[dataset.name] = dataset
    return next(iter(parts.values())) if len(parts) == 1 else Dataset.mixture(parts)
