"""Finds out what a folder is and opens it; several folders become one mixture."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path

from freetalk.data.dataset import MotionDataset
from freetalk.data.emovoca import read_emovoca
from freetalk.data.errors import Findings, LayoutError, MissingFileError
from freetalk.data.folder import read_folder
from freetalk.data.layouts import Request, folder_settings, motion_folder
from freetalk.data.mead import is_actor, is_emote, read_emote, read_mead
from freetalk.data.mixed import MixedDataset
from freetalk.data.neutral_sets import read_biwi, read_multiface
from freetalk.data.open_corpus import OpenCorpus
from freetalk.data.registered import RegisteredDataset, RegisteredParts
from freetalk.data.vocaset import is_released, read_faceformer, read_released

#: Adapter of each layout.
READERS: dict[str, Callable[[Request], RegisteredParts]] = {
    "vocaset": read_released,
    "vocaset-faceformer": read_faceformer,
    "biwi": read_biwi,
    "multiface": read_multiface,
    "emovoca": read_emovoca,
    "mead-emote": read_emote,
    "mead": read_mead,
    "folder": read_folder,
}
KINDS = ("open", *READERS)


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


def kind_of(directory: Path) -> str:
    """The layout of a folder: its ``dataset.json``, or what its files say.

    Raises:
        MissingFileError, LayoutError: no folder; none of the known layouts, with what was looked for.
    """
    if not directory.is_dir():
        raise MissingFileError(f"{directory} is no folder")
    stated = folder_settings(directory).get("kind")
    if stated is not None:
        if stated not in KINDS:
            raise LayoutError(
                f"{directory}/dataset.json: no kind {stated!r}; known: {', '.join(KINDS)}"
            )
        return str(stated)
    if (directory / "manifest.json").is_file():
        return "open"
    if is_released(directory):
        return "vocaset"
    if is_emote(directory):
        return "mead-emote"
    motion = motion_folder(directory)
    if motion is None:
        raise LayoutError(
            f"{directory} is no known dataset. Looked for manifest.json (open corpus), data_verts.npy "
            "(VOCAset), reconstructions (MEAD-EMOTE), or a folder vertices_npy, vertices, sequences or "
            "motion beside wav (VOCAset of FaceFormer, BIWI_6, Multiface, EmoVOCA, your own)"
        )
    return _kind_of_pairs(directory, motion)


def _kind_of_pairs(directory: Path, motion: Path) -> str:
    stem = next((path.stem for path in sorted(motion.glob("*.npy"))), "")
    if (directory / "labels.csv").is_file():
        return "folder"
    if motion.name == "sequences" and re.search(r"_sentence\d+_[A-Za-z]+\d?_\d\Z", stem):
        return "emovoca"
    if re.match(r"FaceTalk_.*_sentence\d+\Z", stem):
        return "vocaset-faceformer"
    if re.match(r"[FM]\d+_e?\d+\Z", stem):
        return "biwi"
    if re.match(r"\d{8}([_-]|\Z)", stem):
        return "multiface"
    if is_actor(stem.partition("_")[0]):
        return "mead"
    return "folder"


def open_dataset(
    path: str | Path,
    *,
    name: str = "",
    split: str = "",
    unit: str = "auto",
    kind: str = "",
    findings: Findings | None = None,
) -> MotionDataset:
    """Opens a dataset of any known layout.

    Args:
        path: its folder.
        name: what results call it; by default the folder's ``dataset.json`` or its own name.
        split: name of the split scheme; empty for the dataset's usual one.
        unit: length unit of the files: m, cm, mm, in, or ``auto``.
        kind: one of ``KINDS``; empty finds out.
        findings: collects what is wrong with single sequences instead of raising it.

    Raises:
        DatasetError: what is missing or wrong, by name.
        ValueError: an unknown kind.
    """
    directory = Path(path).resolve()
    kind = kind or kind_of(directory)
    if kind == "open":
        return OpenCorpus(directory)
    if kind not in READERS:
        raise ValueError(f"no kind of dataset {kind!r}; known: {', '.join(KINDS)}")
    request = Request(directory, split, unit, findings or Findings())
    name = name or str(folder_settings(directory).get("name", directory.name))
    return RegisteredDataset(name, directory, READERS[kind](request), findings)


def open_datasets(specs: str | Path | Iterable[str | Path]) -> MotionDataset:
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
    if len(given) == 1 and not parse_spec(str(given[0]))[0]:
        return open_dataset(given[0])
    parts: dict[str, MotionDataset] = {}
    for spec in given:
        name, split, path = parse_spec(str(spec))
        dataset = open_dataset(path, name=name, split=split)
        name = name or dataset.name
        if name in parts:
            raise ValueError(f"two datasets are called {name}; give them names: NAME=PATH")
        parts[name] = dataset
    return next(iter(parts.values())) if len(parts) == 1 else MixedDataset(parts)
