"""The five datasets of the tables: as given, or their counterparts cut out of the open corpus."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from freetalk.data import Dataset, MotionSequence, open_dataset, parse_spec
from freetalk.tables.papers import DATASETS
from freetalk.tables.views import ViewOptions, view_of

Meshings = Mapping[str, Sequence[str]]


@dataclass(frozen=True)
class OpenSet:
    """The part of the open corpus that stands for a dataset.

    Attributes:
        sources: of its sequences.
        emotional: whether they show emotions, are neutral, or (``None``) either.
        voices: how its speakers' names begin; empty: all.
        family: of its meshings.
    """

    sources: tuple[str, ...]
    emotional: bool | None
    voices: tuple[str, ...]
    family: str

    def holds(self, sequence: MotionSequence) -> bool:
        """Whether a sequence of the corpus belongs to it."""
        if sequence.source not in self.sources:
            return False
        if self.emotional is not None and (sequence.emotion != 0) != self.emotional:
            return False
        return not self.voices or (sequence.voice or "").startswith(self.voices)


#: EmoVOCA gives emotions to VOCASET's takes, and so does 1 to those of 3; 1 to 3 share a template's family.
OPEN_SETS = {
    "EmoVOCA": OpenSet(("facegood",), True, (), "face"),
    "MEAD-EMOTE": OpenSet(("synthetic", "emodb"), True, (), "face"),
    "VOCASET": OpenSet(("facegood",), False, (), "face"),
    "BIWI": OpenSet(("synthetic",), False, ("espeak:en-",), "narrow"),
    "Multiface": OpenSet(("synthetic",), False, ("espeak:en+", "flite:"), "head"),
}

#: Meshings by family and split; those of a test split are never trained on.
SMALL_FAMILIES: dict[str, Meshings] = {
    "face": {
        "train": ("face_dec900", "face_iso1000"),
        "val": ("face_dec1200",),
        "test": ("face_iso2500",),
    },
    "narrow": {
        "train": ("narrow_dec900", "narrow_torn1000"),
        "val": ("narrow_dec1500",),
        "test": ("narrow_iso2000",),
    },
    "head": {
        "train": ("head_dec1000", "sockets_dec1500"),
        "val": ("head_torn1800",),
        "test": ("head_dec2000",),
    },
}
#: Of a corpus of size tiny, whose few sequences stand for several datasets at once.
TINY_SETS = {
    name: dataclasses.replace(own, emotional=None, voices=()) for name, own in OPEN_SETS.items()
}
_TINY: Meshings = {
    "train": ("narrow_dec1500", "face_dec1200"),
    "val": ("face_iso2500",),
    "test": ("head_holes4000",),
}
TINY_FAMILIES: dict[str, Meshings] = {"face": _TINY, "narrow": _TINY, "head": _TINY}
FULL_FAMILIES: dict[str, Meshings] = {
    "face": {
        "train": ("face_dec2500", "face_dec1200", "face_sub3500", "face_iso1000", "face_dec900"),
        "val": ("face_iso2500",),
        "test": ("face_iso5000",),
    },
    "narrow": {
        "train": ("narrow", "narrow_dec1500", "narrow_torn2500", "narrow_dec900"),
        "val": ("narrow_torn1000",),
        "test": ("narrow_iso2000",),
    },
    "head": {
        "train": ("head_dec2000", "head_iso3000", "sockets_dec3000", "head_torn1800"),
        "val": ("sockets_dec5000",),
        "test": ("head_holes4000",),
    },
}


class Catalogue:
    """The datasets of the tables by name.

    Args:
        specs: a folder of the open corpus, or ``NAME=DIR`` (``NAME:SPLIT=DIR``) of real ones, where a
            name is one of ``freetalk.tables.papers.DATASETS``.
        families: meshings of the open corpus's counterparts.
        counterparts: what of the open corpus stands for each dataset.

    Raises:
        ValueError: an unknown name, or a plain folder that is not the open corpus.
    """

    def __init__(
        self,
        specs: Sequence[str],
        families: Mapping[str, Meshings],
        counterparts: Mapping[str, OpenSet] = OPEN_SETS,
    ) -> None:
        self._families, self._counterparts = families, counterparts
        self._datasets: dict[str, Dataset] = {}
        self._corpus: Dataset | None = None
        for spec in specs:
            name, split, path = parse_spec(spec)
            if name:
                if name not in DATASETS.values():
                    known = ", ".join(DATASETS.values())
                    raise ValueError(f"--data {spec}: the tables' datasets are {known}")
                self._datasets[name] = open_dataset(path, name=name, split=split)
                continue
            corpus = open_dataset(Path(path))
            if corpus.drawn() is None:
                raise ValueError(f"--data {spec}: say which dataset it is, NAME=DIR")
            self._corpus = corpus

    @property
    def is_open(self) -> bool:
        """Whether the open corpus stands for some of the datasets."""
        return self._corpus is not None

    def view(self, name: str, options: ViewOptions) -> Dataset:
        """A part of a dataset.

        Raises:
            ValueError: it is not given, and neither is the open corpus; the corpus is too small.
        """
        if name in self._datasets:
            return view_of(self._datasets[name], name, options)
        if self._corpus is None:
            raise ValueError(f"this row needs {name}: give --data {name}=DIR")
        own = self._counterparts[name]
        meshings = self._families[own.family]
        wanted = {topology for split in meshings.values() for topology in split}
        lacking = sorted(wanted - set(self._corpus.topologies()))
        if lacking:
            raise ValueError(
                f"the corpus has no meshing {lacking[0]}, which {name}'s counterpart needs: "
                "build a larger corpus (freetalk corpus build --size small), or make the table at --size tiny"
            )
        return view_of(self._corpus, name, options, own.holds, meshings)

    def mixture(self, names: Sequence[str], options: ViewOptions) -> Dataset:
        """Several datasets as one; each keeps its meshes and frame rate."""
        views = {name: self.view(name, options) for name in names}
        return views[names[0]] if len(names) == 1 else Dataset.mixture(views)

    def describe(self) -> dict[str, str]:
        """Where each dataset comes from."""
        sources = {}
        for name in DATASETS.values():
            if name in self._datasets:
                sources[name] = self._datasets[name].name
            elif self._corpus is not None:
                own = self._counterparts[name]
                kind = {True: "emotional ", False: "neutral ", None: ""}[own.emotional]
                made = self._corpus.describe()
                sources[name] = (
                    f"open corpus (size {made['size']}, seed {made['seed']}), {kind}"
                    f"{' and '.join(own.sources)} on {own.family} meshings"
                )
        return sources


def parse_sets(text: str) -> tuple[str, ...]:
    """Names of ``1,2,4,5``.

    Raises:
        ValueError: a number that no dataset has.
    """
    numbers = [part.strip() for part in text.split(",")]
    unknown = [n for n in numbers if not n.isdigit() or int(n) not in DATASETS]
    if unknown:
        known = ", ".join(f"{number} {name}" for number, name in DATASETS.items())
        raise ValueError(f"no dataset {unknown[0]!r}; known: {known}")
    return tuple(DATASETS[int(n)] for n in numbers)
