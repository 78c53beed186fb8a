"""Numbers that FreeTalk and FaceTalk print, for the columns beside ours; units are the papers', mostly unstated."""

from __future__ import annotations

#: The order of [FreeTalk 4.1]: "(a,b + c,d)" trains ATS on the first and STM on the second.
DATASETS = {1: "EmoVOCA", 2: "MEAD-EMOTE", 3: "VOCASET", 4: "BIWI", 5: "Multiface"}

METRICS = ("lve", "mve_mean", "fdd", "dtw", "dfd", "delta_m", "delta_cd")
_Scores = dict[str, float]


def _scores(*values: float) -> _Scores:
    return dict(zip(METRICS, values, strict=True))


#: FreeTalk's rows of Table 2, on MEAD-EMOTE. The FDD and the DTW of "2 + 1,2,4,5" are as printed; they are almost
#: surely swapped: its other rows have a DTW of 2.6 and an FDD of 3 to 5.
TABLE_2: dict[str, dict[str, _Scores]] = {
    "1,2,4,5 + 1,2,4,5": {"MEAD-EMOTE": _scores(16.4, 2.29, 3.35, 2.65, 11.4, 4.61, 0.83)},
    "1,2,4,5 + 2": {"MEAD-EMOTE": _scores(16.6, 2.31, 3.52, 2.65, 11.4, 4.60, 0.83)},
    "2 + 1,2,4,5": {"MEAD-EMOTE": _scores(13.7, 2.27, 2.61, 4.93, 11.1, 3.23, 0.82)},
    "2 + 2": {"MEAD-EMOTE": _scores(13.8, 2.27, 5.12, 2.60, 11.0, 3.25, 0.81)},
}

#: FreeTalk's rows of Table 3.
TABLE_3: dict[str, dict[str, _Scores]] = {
    "1,2,4,5 + 1,2,4,5": {
        "VOCASET": _scores(4.28, 0.99, 1.38, 1.87, 5.87, 0.39, 0.73),
        "BIWI": _scores(6.10, 2.45, 40.3, 1.55, 6.84, 1.82, 0.76),
        "Multiface": _scores(10.7, 2.39, 5.34, 1.81, 6.89, 0.71, 0.90),
    },
    "1,2,4,5 + 3,4,5": {
        "VOCASET": _scores(4.01, 1.01, 1.67, 1.73, 5.69, 0.36, 0.74),
        "BIWI": _scores(5.58, 2.37, 30.8, 1.56, 7.14, 1.76, 0.75),
        "Multiface": _scores(7.89, 2.31, 4.01, 1.58, 6.35, 0.65, 0.89),
    },
    "3,4,5 + 1,2,4,5": {
        "VOCASET": _scores(3.12, 0.94, 1.56, 1.61, 5.08, 0.33, 0.67),
        "BIWI": _scores(4.72, 2.20, 36.0, 1.52, 6.54, 1.13, 0.63),
        "Multiface": _scores(3.90, 1.95, 16.4, 1.19, 5.36, 0.44, 0.77),
    },
    "3,4,5 + 3,4,5": {
        "VOCASET": _scores(3.05, 0.95, 1.85, 1.60, 5.16, 0.31, 0.69),
        "BIWI": _scores(4.44, 2.17, 30.0, 1.53, 6.87, 1.11, 0.63),
        "Multiface": _scores(3.19, 1.92, 14.3, 1.14, 5.29, 0.46, 0.76),
    },
}

#: LVE of supp. Table 1 by (extractor, decoder).
SUPP_1: dict[tuple[str, str], float] = {
    ("mlp", "mlp"): 0.0020,
    ("mlp", "diffusionnet"): 0.0023,
    ("mlp", "njf"): 0.0018,
    ("diffusionnet", "mlp"): 0.0017,
    ("diffusionnet", "diffusionnet"): 0.0021,
    ("diffusionnet", "njf"): 0.0018,
    ("poissonnet", "mlp"): 0.0016,
    ("poissonnet", "diffusionnet"): 0.0020,
    ("poissonnet", "njf"): 0.0017,
}

#: LVE of supp. Table 2 by fusion.
SUPP_2: dict[str, float] = {
    "concat": 0.0035,
    "ca": 0.0025,
    "ca_concat": 0.0023,
    "gcn_ca_concat": 0.0021,
}

#: (LSE-D, diversity) of FaceTalk's Table 2 by row.
FACETALK_2: dict[str, tuple[float, float]] = {
    "full": (11.2737, 0.34),
    "no amplitude augmentation": (11.6229, 1.61e-8),
    "no FiLM": (12.029, 0.006),
    "no alignment": (13.720, 5.17e-8),
    "no diffusion": (11.3217, 0.0),
}

#: LSE-D of FaceTalk's Table 3; its weights are FLAME's.
FACETALK_3: dict[str, float] = {
    "weights": 11.6839,
    "head": 11.2737,
    "head, no diffusion": 11.3217,
}

#: (LSE-D, diversity) of FaceTalk's Table 5 by row.
FACETALK_5: dict[str, tuple[float, float]] = {
    "input": (12.029, 0.006),
    "scale_shift": (11.9575, 0.204),
    "squeeze_excite": (11.7586, 0.029),
    "dot_product": (12.83, 2.009e-7),
    "film": (11.2737, 0.340),
}

#: (MAE, RMSE) between neighbouring codes of FaceTalk's Table 4 by row.
FACETALK_4: dict[str, tuple[float, float]] = {
    "no temporal loss": (0.01422, 0.01978),
    "temporal loss": (0.00248, 0.00623),
}

#: (LSE-D, FID, KID) of FaceTalk's Table 1: the nearest other system, and the paper's own.
FACETALK_1: dict[str, tuple[float, float, float]] = {
    "Imitator": (11.6119, 208.479, 0.212),
    "FaceTalk": (11.2737, 40.692, 0.009),
}
