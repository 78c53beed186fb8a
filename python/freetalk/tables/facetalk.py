"""FaceTalk's tables: 2 (design), 3 (what the codes are) and 5 (how the diffusion step is told)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from freetalk.tables import definitions
from freetalk.tables.claims import Claim
from freetalk.tables.definitions import NEUTRAL, STILL, Recipes
from freetalk.tables.papers import FACETALK_2, FACETALK_3, FACETALK_5
from freetalk.tables.scoring import DIVERSITY
from freetalk.tables.table import Row, Table

FULL = "full"
METRICS = ("lve", "mve_mean", DIVERSITY)
TARGETS = ("weights",)
_SCORED = (
    "Scored on the 68 landmarks that the codes move, one sample a clip; the paper's LSE-D is of rendered "
    "video, by weights that are not free (`freetalk.evaluate.syncnet` reads a user's)."
)
_DIVERSITY = (
    "Diversity [Eq. 20] is of four samples a clip, over whole clips of codes; more is better."
)
_VARIANTS = {
    FULL: (),
    "no amplitude augmentation": ("task.amplitude_low=1", "task.amplitude_high=1"),
    "no FiLM": ("model.time_condition=input",),
    "no alignment": ("model.align_audio=false",),
    "no diffusion": ("model.diffusion=false",),
}
_CONDITIONS = ("input", "scale_shift", "squeeze_excite", "dot_product", "film")


def facetalk_2(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """What the parts of the denoiser are for [FaceTalk, Table 2]; facial smoothing is no part of it."""
    rows = _rows(recipes, FACETALK_2, _VARIANTS)
    others = [name for name in _VARIANTS if name != FULL]
    claims = [
        Claim(
            f"{name}: lips follow the speech less well (LVE)",
            f"Table 2: LSE-D {FACETALK_2[FULL][0]} and {FACETALK_2[name][0]}",
            (FULL,),
            (name,),
        )
        for name in others
    ]
    claims += [_varies_less(name, FULL, FACETALK_2, "Table 2") for name in others]
    return _table(
        "facetalk_2", "Design of FaceTalk's denoiser [FaceTalk, Table 2]", rows, claims, recipes
    )


def facetalk_3(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """What the codes are, with and without diffusion [FaceTalk, Table 3]."""
    rows, claims = [], []
    for target in settings or TARGETS:
        if target not in ("weights", "head"):
            raise ValueError(f"setting {target!r}: targets are weights and head")
        for name, overrides in (
            (target, ()),
            (f"{target}, no diffusion", _VARIANTS["no diffusion"]),
        ):
            training = recipes.facetalk(NEUTRAL, f"task.targets={target}", *overrides)
            rows.append(Row(name, None, None, facetalk=training))
        claims.append(
            Claim(
                f"{target}: without diffusion lips follow the speech less well (LVE)",
                f"Table 3: LSE-D {FACETALK_3['head']} and {FACETALK_3['head, no diffusion']}, of codes of a head",
                (target,),
                (f"{target}, no diffusion",),
            )
        )
    claims.append(
        Claim(
            "codes of a head follow the speech better than weights of expressions (LVE)",
            f"Table 3: LSE-D {FACETALK_3['head']} and {FACETALK_3['weights']}",
            ("head",),
            ("weights",),
        )
    )
    title = "Weights of expressions and codes of a head [FaceTalk, Table 3]"
    return _table("facetalk_3", title, tuple(rows), claims, recipes)


def facetalk_5(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """How the diffusion step is told to the denoiser [FaceTalk, Table 5]."""
    # Named so that rows of Table 2 are shared.
    told = {n: () if n == "film" else (f"model.time_condition={n}",) for n in _CONDITIONS}
    rows = _rows(recipes, FACETALK_5, told)
    others = [name for name in _CONDITIONS if name != "film"]
    claims = [
        Claim(
            f"lips follow the speech better with film than with {name} (LVE)",
            f"Table 5: LSE-D {FACETALK_5['film'][0]} and {FACETALK_5[name][0]}",
            ("film",),
            (name,),
        )
        for name in others
    ]
    claims += [_varies_less(name, "film", FACETALK_5, "Table 5") for name in others]
    title = "How the diffusion step is told [FaceTalk, Table 5]"
    return _table("facetalk_5", title, rows, claims, recipes)


def _rows(
    recipes: Recipes,
    printed: dict[str, tuple[float, float]],
    overrides: Mapping[str, tuple[str, ...]],
) -> tuple[Row, ...]:
    """A row a variant, with the printed diversity."""
    return tuple(
        Row(
            name,
            None,
            None,
            {"all": {DIVERSITY: printed[name][1]}},
            recipes.facetalk(NEUTRAL, *own),
        )
        for name, own in overrides.items()
    )


def _varies_less(
    name: str, than: str, printed: dict[str, tuple[float, float]], where: str
) -> Claim:
    source = f"{where}: diversity {printed[name][1]:g} and {printed[than][1]:g}"
    return Claim(f"{name}: samples vary less than {than}", source, (name,), (than,), DIVERSITY)


def _table(
    name: str, title: str, rows: tuple[Row, ...], claims: Sequence[Claim], recipes: Recipes
) -> Table:
    return Table(
        name=name,
        title=title,
        rows=(*rows, STILL),
        tests=NEUTRAL,
        view=recipes.size.ats,
        metrics=METRICS,
        claims=tuple(claims),
        notes=(_SCORED, _DIVERSITY),
        pooled=True,
    )


TABLES: dict[str, Callable[[Recipes, Sequence[str]], Table]] = {
    **definitions.TABLES,
    "facetalk_2": facetalk_2,
    "facetalk_3": facetalk_3,
    "facetalk_5": facetalk_5,
}
