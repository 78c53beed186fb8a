"""The built-in face as a model that is fitted to surfaces."""

from __future__ import annotations

from functools import lru_cache

from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.data.expressive_faces import ExpressiveFace
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


@lru_cache(maxsize=1)
def built_in_head() -> ExpressiveFace:
    """The ICT face with neck, its expressions too."""
    model, count = load_face_model(), EXTENTS["head"]
    return ExpressiveFace(
        model.neutral[:count],
        triangulate(crop_quads(model, "head")),
        model.identity_basis[:, :count],
        model.landmarks68,
        model.expression_basis[:, :count],
        model.expression_names,
    )
