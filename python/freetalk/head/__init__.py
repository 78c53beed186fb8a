"""Neural parametric heads: codes of an identity and an expression to a signed distance field.

Fields take points and give distances in head units, metres times ``options.units_per_metre``, in FLAME's axes.
Meshes, templates and the points of fits are in metres.
"""

from __future__ import annotations

from freetalk.head.codes import (
    Codes,
    Fit,
    FitOptions,
    content_hash,
    fit_expressions,
    fit_identity,
    load_codes,
    save_codes,
)
from freetalk.head.model import (
    HeadOptions,
    ParametricHead,
    PreparedHead,
    nphm_paper_options,
    nphm_small_options,
)
from freetalk.head.nphm import load_nphm
from freetalk.head.track import (
    SmoothingOptions,
    Surface,
    SurfaceExtractor,
    SurfaceOptions,
    TrackOptions,
    canonical_template,
    extract,
    smoothing_weights,
    track,
)

__all__ = [
    "Codes",
    "Fit",
    "FitOptions",
    "HeadOptions",
    "ParametricHead",
    "PreparedHead",
    "SmoothingOptions",
    "Surface",
    "SurfaceExtractor",
    "SurfaceOptions",
    "TrackOptions",
    "canonical_template",
    "content_hash",
    "extract",
    "fit_expressions",
    "fit_identity",
    "load_codes",
    "load_nphm",
    "nphm_paper_options",
    "nphm_small_options",
    "save_codes",
    "smoothing_weights",
    "track",
]
