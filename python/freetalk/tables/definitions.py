"""The tables: FreeTalk's 2 and 3, the supplement's 1 and 2, and a sweep of the attention's radius."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

from freetalk.tables.claims import Claim
from freetalk.tables.papers import METRICS, SUPP_1, SUPP_2, TABLE_2, TABLE_3
from freetalk.tables.scoring import ROUGHNESS
from freetalk.tables.sets import parse_sets
from freetalk.tables.sizes import Size
from freetalk.tables.table import Row, Table
from freetalk.tables.training import Training
from freetalk.tables.views import ViewOptions

EXTRACTORS = ("mlp", "diffusionnet", "poissonnet")
DECODERS = ("mlp", "diffusionnet", "njf")
FUSIONS = ("concat", "ca", "ca_concat", "gcn_ca_concat")
#: Radii of the band mask, in frames to each side; the last is no mask at all.
RADII = (0, 1, 3, 10, 1000)
NEUTRAL = ("VOCASET", "BIWI", "Multiface")
#: Of trainings.
KINDS = ("stm", "ats", "facetalk")
STILL = Row("still face", None, None)
_PROTOCOL = "Clips of 15 to 30 frames at 10 fps, half of the sequences [supp. 3]."
_ROUGHNESS = "Roughness: how far the errors of neighbouring vertices of the lips differ, mean over edges and frames."


class Recipes:
    """Trainings of a size with a seed and further overrides, ``KIND.section.key=value``.

    Raises:
        ValueError: an override that belongs to no kind of training.
    """

    def __init__(self, size: Size, seed: int, overrides: Sequence[str] = ()) -> None:
        self.size = size
        self._overrides: dict[str, tuple[str, ...]] = {}
        for kind in KINDS:
            own = tuple(o.removeprefix(f"{kind}.") for o in overrides if o.startswith(f"{kind}."))
            given = size.overrides.get(kind, ())
            self._overrides[kind] = (*given, f"loop.seed={seed}", *own)
        known = tuple(f"{kind}." for kind in KINDS)
        strange = [o for o in overrides if not o.startswith(known) or "=" not in o]
        if strange:
            raise ValueError(
                f"{strange[0]!r}: overrides are KIND.section.key=value, KIND one of {', '.join(KINDS)}"
            )

    def ablation(self, *overrides: str) -> Training:
        """Landmarks to mesh on the neutral sets, as the supplement's studies."""
        return self._training("stm", NEUTRAL, self.size.ablation, overrides)

    def stm(self, sets: tuple[str, ...]) -> Training:
        """Landmarks to mesh on given sets."""
        return self._training("stm", sets, self.size.stm, ())

    def ats(self, sets: tuple[str, ...], *overrides: str) -> Training:
        """Audio to landmarks on given sets."""
        return self._training("ats", sets, self.size.ats, overrides)

    def facetalk(self, sets: tuple[str, ...], *overrides: str) -> Training:
        """Audio to codes on given sets."""
        return self._training("facetalk", sets, self.size.ats, overrides)

    def _training(
        self, kind: str, sets: tuple[str, ...], view: ViewOptions, overrides: Sequence[str]
    ) -> Training:
        return Training(
            kind=kind,
            sets=sets,
            view=view,
            config=self.size.configs[kind],
            overrides=(*self._overrides[kind], *overrides),
        )


def supp_1(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """Component substitution [FreeTalk, supp. Table 1]."""
    rows = tuple(
        Row(
            name=f"{extractor} + {decoder}",
            stm=recipes.ablation(f"model.extractor={extractor}", f"model.decoder={decoder}"),
            ats=None,
            paper={"all": {"lve": SUPP_1[extractor, decoder]}},
        )
        for extractor, decoder in itertools.product(EXTRACTORS, DECODERS)
    )

    def with_extractor(name: str) -> tuple[str, ...]:
        return tuple(f"{name} + {decoder}" for decoder in DECODERS)

    def with_decoder(name: str) -> tuple[str, ...]:
        return tuple(f"{extractor} + {name}" for extractor in EXTRACTORS)

    def compared(a: str, b: str, names: Callable[[str], tuple[str, ...]], printed: str) -> Claim:
        part = "extractor" if names is with_extractor else "decoder"
        text = f"LVE with {a} as {part} is below that with {b}"
        return Claim(text, f"supp. Table 1: {printed}", names(a), names(b))

    noise = "supp. 3, Fig. 1: of a picture, no number"
    claims = (
        compared("diffusionnet", "mlp", with_extractor, "means .00187 and .00203"),
        compared("poissonnet", "diffusionnet", with_extractor, "means .00177 and .00187"),
        compared("poissonnet", "mlp", with_extractor, "means .00177 and .00203"),
        compared("mlp", "diffusionnet", with_decoder, "means .00177 and .00213"),
        compared("njf", "diffusionnet", with_decoder, "means .00177 and .00213"),
        Claim(
            "an MLP as decoder leaves noisier lips than DiffusionNet (error of neighbouring vertices)",
            noise,
            with_decoder("diffusionnet"),
            with_decoder("mlp"),
            metric=ROUGHNESS,
        ),
        Claim(
            "NJF as decoder leaves smoother lips than an MLP",
            noise,
            with_decoder("njf"),
            with_decoder("mlp"),
            metric=ROUGHNESS,
        ),
    )
    return Table(
        name="supp_1",
        title="Component substitution of STM [FreeTalk, supp. Table 1]",
        rows=(*rows, STILL),
        tests=NEUTRAL,
        view=recipes.size.ablation,
        metrics=("lve", "mve_mean", ROUGHNESS),
        claims=claims,
        notes=(
            "Rows are extractor + decoder; true landmarks move the faces. " + _PROTOCOL,
            _ROUGHNESS,
        ),
        pooled=True,
    )


def supp_2(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """Feature combination [FreeTalk, supp. Table 2]."""
    rows = tuple(
        Row(
            name=fusion,
            stm=recipes.ablation(f"model.fusion={fusion}"),
            ats=None,
            paper={"all": {"lve": SUPP_2[fusion]}},
        )
        for fusion in FUSIONS
    )
    pairs = (("gcn_ca_concat", "ca_concat"), ("ca_concat", "ca"), ("ca", "concat"))
    claims = [
        Claim(f"{a} beats {b} ({title})", source.format(SUPP_2[a], SUPP_2[b]), (a,), (b,), metric)
        for metric, title, source in (
            ("lve", "LVE", "supp. Table 2: {:.4f} and {:.4f}"),
            ("mve_mean", "MVE", "no number"),
        )
        for a, b in (*pairs, ("gcn_ca_concat", "concat"))
    ]
    return Table(
        name="supp_2",
        title="Feature combination of STM [FreeTalk, supp. Table 2]",
        rows=(*rows, STILL),
        tests=NEUTRAL,
        view=recipes.size.ablation,
        metrics=("lve", "mve_mean", ROUGHNESS),
        claims=tuple(claims),
        notes=("True landmarks move the faces. " + _PROTOCOL, _ROUGHNESS),
        pooled=True,
    )


def radius(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """The radius of the band of cross-attention, which the paper leaves open [FreeTalk, Eq. 9-10]."""
    sets = parse_sets("3,4,5")
    values = [int(s) for s in settings] or list(RADII)

    def name(r: int) -> str:
        return f"r = {r}" if r < RADII[-1] else "no mask"

    rows = tuple(
        Row(
            name=name(r),
            stm=None,
            ats=recipes.ats(sets, f"model.band_radius={r}"),
        )
        for r in values
    )
    text = "the band around a frame helps: LVE with {} is below that without a mask"
    source = "3.1: attention only within a radius; no number"
    claims = tuple(
        Claim(text.format(name(r)), source, (name(r),), ("no mask",)) for r in values if r < 1000
    )
    return Table(
        name="radius",
        title="Radius r of the band mask of ATS's cross-attention [FreeTalk, Eq. 9-10]",
        rows=(*rows, STILL),
        tests=NEUTRAL,
        view=recipes.size.ats,
        metrics=METRICS,
        claims=claims,
        notes=("Scored on the 68 landmarks themselves, one sample a clip.",),
        pooled=True,
    )


def _mixed(
    recipes: Recipes, printed: dict[str, dict[str, dict[str, float]]], settings: Sequence[str]
) -> tuple[Row, ...]:
    rows = []
    for setting in settings or printed:
        ats, plus, stm = (part.strip() for part in setting.partition("+"))
        if not plus:
            raise ValueError(f"setting {setting!r}: write ATS's datasets + STM's, as 1,2,4,5+3,4,5")
        name = f"{ats.replace(' ', '')} + {stm.replace(' ', '')}"
        rows.append(
            Row(
                name=name,
                stm=recipes.stm(parse_sets(stm)),
                ats=recipes.ats(parse_sets(ats)),
                paper=printed.get(name, {}),
            )
        )
    return tuple(rows)


def table_2(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """Emotional speech to meshes [FreeTalk, Table 2]."""
    everything, single = "1,2,4,5 + 1,2,4,5", "2 + 2"
    claims = (
        Claim(
            "trained on the test's own dataset alone, both stages score best",
            "4.2: LVE 13.8 and 16.4",
            (single,),
            (everything,),
        ),
        Claim(
            "the gain is ATS's: its own dataset alone against the mixture",
            "Table 2: LVE 13.7 and 16.4",
            ("2 + 1,2,4,5",),
            (everything,),
        ),
        Claim(
            "STM trained on the mixture is as good as on the test's own dataset (within 5 %)",
            "Table 2: LVE 13.7 and 13.8",
            ("2 + 1,2,4,5",),
            (single,),
            margin=0.05,
        ),
        Claim(
            "trained on heterogeneous datasets, FreeTalk stays competitive (LVE within 20 %)",
            "4.2: LVE 16.4 and 13.8, 19 %",
            (everything,),
            (single,),
            margin=0.2,
        ),
        Claim(
            "trained on heterogeneous datasets, FreeTalk stays competitive (MVE within 5 %)",
            "4.2: MVE 2.29 and 2.27, 1 %",
            (everything,),
            (single,),
            metric="mve_mean",
            margin=0.05,
        ),
    )
    return Table(
        name="table_2",
        title="Emotional speech to meshes [FreeTalk, Table 2]",
        rows=(*_mixed(recipes, TABLE_2, settings), STILL),
        tests=("MEAD-EMOTE",),
        view=recipes.size.ats,
        metrics=METRICS,
        claims=claims,
        notes=(
            "Rows are datasets of ATS + datasets of STM; the whole pipeline from sound, one sample a clip.",
        ),
    )


def table_3(recipes: Recipes, settings: Sequence[str] = ()) -> Table:
    """Neutral speech to meshes by what each stage was trained on [FreeTalk, Table 3]."""
    expressive, neutral = "1,2,4,5 + 1,2,4,5", "3,4,5 + 3,4,5"
    claims = [
        Claim(
            f"trained on expressive data, FreeTalk is worse on neutral {name}",
            "4.2 and Table 3: LVE "
            f"{TABLE_3[neutral][name]['lve']:g} and {TABLE_3[expressive][name]['lve']:g}",
            (neutral,),
            (expressive,),
            dataset=name,
        )
        for name in NEUTRAL
    ]
    claims.append(
        Claim(
            "what ATS was trained on matters more than what STM was",
            "Table 3: mean LVE of the three 3.91 and 5.83",
            ("3,4,5 + 1,2,4,5",),
            ("1,2,4,5 + 3,4,5",),
        )
    )
    claims.append(
        Claim(
            "STM trained on other datasets costs little (LVE within 10 %)",
            "Table 3: mean LVE of the three 3.91 and 3.56",
            ("3,4,5 + 1,2,4,5",),
            (neutral,),
            margin=0.1,
        )
    )
    return Table(
        name="table_3",
        title="Neutral speech to meshes, by training data [FreeTalk, Table 3]",
        rows=(*_mixed(recipes, TABLE_3, settings), STILL),
        tests=NEUTRAL,
        view=recipes.size.ats,
        metrics=METRICS,
        claims=tuple(claims),
        notes=(
            "Rows are datasets of ATS + datasets of STM; the whole pipeline from sound, one sample a clip.",
        ),
    )


TABLES: dict[str, Callable[[Recipes, Sequence[str]], Table]] = {
    "table_2": table_2,
    "table_3": table_3,
    "supp_1": supp_1,
    "supp_2": supp_2,
    "radius": radius,
}
