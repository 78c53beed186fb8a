"""A part of a dataset as a dataset: some sequences, cut into clips, at another frame rate, on some meshings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from freetalk.data import Dataset, MotionSequence
from freetalk.data.splits import SPLITS


@dataclass(frozen=True)
class ViewOptions:
    """What of a dataset a view shows.

    Attributes:
        fps: frames per second; 0 keeps the dataset's.
        clip_frames: sequences are cut into clips of at most so many frames; 0 leaves them whole.
        min_frames: shorter clips are left out.
        every: of the splits train and test, every n-th sequence is taken.
        limits: most clips of a split, spread evenly over it; absent: all.
        identities: most faces of a split; absent: all.
    """

    fps: float = 0.0
    clip_frames: int = 0
    min_frames: int = 1
    every: int = 1
    limits: Mapping[str, int] = field(default_factory=dict)
    identities: Mapping[str, int] = field(default_factory=dict)


def view_of(
    base: Dataset,
    name: str,
    options: ViewOptions,
    keep: Callable[[MotionSequence], bool] = lambda sequence: True,
    topologies: Mapping[str, Sequence[str]] | None = None,
) -> Dataset:
    """A part of a dataset.

    Args:
        base: the dataset.
        name: what the part is called; its faces and sequences say that they belong to it.
        options: what it shows.
        keep: which of the dataset's sequences belong to it.
        topologies: meshings by split, for a dataset whose sequences move any meshing; ``None``: its own.

    Raises:
        ValueError: no sequence is left.
    """
    rated = base.at(options.fps) if options.fps else base
    shown: dict[str, list[MotionSequence]] = {}
    for split in SPLITS:
        own = [s for s in rated.sequences(split) if keep(s)]
        clips = [
            c for s in own[:: 1 if split == "val" else options.every] for c in _cut(s, options)
        ]
        limit = options.limits.get(split, len(clips))
        at = np.unique(np.linspace(0, len(clips) - 1, min(limit, len(clips))).round())
        shown[split] = [clips[int(index)] for index in at]
    sequences = [clip for clips in shown.values() for clip in clips]
    if not sequences:
        raise ValueError(f"no sequence of {base.name} belongs to {name}")
    facts = {
        "of": base.name,
        "clips": {split: len(clips) for split, clips in shown.items()},
        "frames": {split: sum(c.num_frames for c in clips) for split, clips in shown.items()},
    }
    return rated.select(
        sequences, name=name, identities=options.identities, topologies=topologies, facts=facts
    )


def faces_of(view: Dataset, split: str) -> list[tuple[MotionSequence, int, str]]:
    """(clip, identity, topology) that each clip of a split is scored on: the recorded face, or in turn."""
    people, meshings = view.identities(split), view.topologies(split)
    if not people and any(s.topology is None for s in view.sequences(split)):
        raise ValueError(f"{view.name} has no face in its split {split}")
    return [
        (s, s.identity, s.topology)
        if s.topology is not None
        else (s, people[at % len(people)], meshings[at % len(meshings)])
        for at, s in enumerate(view.sequences(split))
    ]


def _cut(sequence: MotionSequence, options: ViewOptions) -> list[MotionSequence]:
    """Clips of a sequence; itself where it is one."""
    total = sequence.num_frames
    length = options.clip_frames or total
    return [
        sequence.clip(
            sequence.id if length >= total else f"{sequence.id}-{first // length}",
            first,
            min(length, total - first),
        )
        for first in range(0, total, length)
        if min(length, total - first) >= options.min_frames
    ]
