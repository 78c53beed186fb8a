"""How large a table is made: seconds for tests, an hour on two cores, or the papers' protocol for a GPU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from freetalk.tables.sets import (
    FULL_FAMILIES,
    OPEN_SETS,
    SMALL_FAMILIES,
    TINY_FAMILIES,
    TINY_SETS,
    Meshings,
    OpenSet,
)
from freetalk.tables.views import ViewOptions


@dataclass(frozen=True)
class Size:
    """A preset.

    Attributes:
        name: ``tiny``, ``small`` or ``full``.
        configs: configuration of each kind of training.
        overrides: ``section.key=value`` on top of them.
        ablation: clips of the component studies [FreeTalk supp. 3].
        stm: clips that the landmarks-to-mesh stage of Tables 2 and 3 is trained on.
        ats: clips that the audio-to-landmarks stage is trained on and whole pipelines are scored on.
        families: meshings of the open corpus's counterparts.
        counterparts: what of the open corpus stands for each dataset.
        sampler: options of the diffusion's sampling.
        seeds: how many seeds each row is trained with, where the command does not say.
    """

    name: str
    configs: Mapping[str, str]
    overrides: Mapping[str, tuple[str, ...]]
    ablation: ViewOptions
    stm: ViewOptions
    ats: ViewOptions
    families: Mapping[str, Meshings]
    counterparts: Mapping[str, OpenSet] = field(default_factory=lambda: OPEN_SETS)
    sampler: Mapping[str, object] = field(default_factory=dict)
    seeds: int = 1


_TWO_STEPS = ("loop.max_steps=2", "loop.validate_every=0", "loop.threads=1")
_TINY_VIEW = ViewOptions(
    fps=10.0,
    clip_frames=20,
    min_frames=8,
    every=2,
    limits={"train": 6, "val": 2, "test": 4},
    identities={"test": 1},
)
TINY = Size(
    name="tiny",
    configs={"stm": "stm_smoke", "ats": "ats_smoke", "facetalk": "facetalk_smoke"},
    overrides={
        "stm": (
            *_TWO_STEPS,
            "task.num_meshes=2",
            "task.validation_windows=4",
            "task.source_weights={}",
            # Stated, as the other sizes' configurations do, so that tables share the row of the defaults.
            "model.extractor=diffusionnet",
            "model.decoder=diffusionnet",
            "model.fusion=gcn_ca_concat",
        ),
        "ats": (
            *_TWO_STEPS,
            "task.feature_augmentations=0",
            "task.validation_windows=2",
            "model.band_radius=3",
        ),
        "facetalk": (*_TWO_STEPS, "task.validation_windows=2", "task.validation_samples=1"),
    },
    ablation=_TINY_VIEW,
    stm=_TINY_VIEW,
    ats=ViewOptions(
        clip_frames=40,
        min_frames=8,
        limits={"train": 4, "val": 2, "test": 3},
        identities={"test": 1},
    ),
    families=TINY_FAMILIES,
    counterparts=TINY_SETS,
    sampler={"sampler": "dpmpp", "num_steps": 2},
)

# 10 fps, 15 to 30 frames and half of the sequences are the protocol of [FreeTalk supp. 3]. The test split keeps
# all its clips up to the limit, because the intervals are over them.
_SMALL_VIEW = ViewOptions(
    fps=10.0,
    clip_frames=30,
    min_frames=15,
    every=2,
    limits={"val": 8, "test": 20},
    identities={"test": 2},
)
SMALL = Size(
    name="small",
    configs={"stm": "table_stm", "ats": "table_ats", "facetalk": "table_facetalk"},
    overrides={},
    ablation=_SMALL_VIEW,
    stm=_SMALL_VIEW,
    ats=ViewOptions(
        clip_frames=90,
        min_frames=45,
        limits={"train": 160, "val": 8, "test": 20},
        identities={"test": 2},
    ),
    families=SMALL_FAMILIES,
    sampler={"sampler": "dpmpp", "num_steps": 20},
    seeds=3,
)

FULL = Size(
    name="full",
    configs={"stm": "stm_paper", "ats": "ats_paper", "facetalk": "facetalk_paper"},
    overrides={
        "stm": ("task.num_meshes=240",),
        "ats": ("model.fps=30",),
        "facetalk": ("task.targets=weights",),
    },
    ablation=ViewOptions(fps=10.0, clip_frames=30, min_frames=15, every=2),
    stm=ViewOptions(),
    ats=ViewOptions(),
    families=FULL_FAMILIES,
    sampler={"sampler": "ddim", "num_steps": 100},
)

SIZES = {size.name: size for size in (TINY, SMALL, FULL)}
