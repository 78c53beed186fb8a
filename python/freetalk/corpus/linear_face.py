"""The built-in face as a model that is fitted to surfaces."""

from __future__ import annotations

from functools import lru_cache

from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.data.landmark_transfer import LinearFace


@lru_cache(maxsize=1)
def built_in_face() -> LinearFace:
    """The ICT face without neck, as what is fitted."""
    model, count = load_face_model(), EXTENTS["face"]
    return LinearFace(
        model.neutral[:count],
        triangulate(crop_quads(model, "face")),
        model.identity_basis[:, :count],
        model.landmarks68,
    )
