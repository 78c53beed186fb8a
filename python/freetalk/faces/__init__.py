"""Finds the face on a mesh of any unit, pose and extent, by looking at pictures of it and by its shape.

Pictures need the extra ``faces`` (MediaPipe) and off-screen OpenGL; without them the shape alone is asked.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from freetalk.corpus.linear_face import built_in_face
from freetalk.faces.detector import INSTALL, available, detector
from freetalk.faces.landmarks import (
    MARKS,
    FoundLandmarks,
    geometric_landmarks,
    home_pose,
    marked_landmarks,
    seen_landmarks,
)
from freetalk.faces.search import search
from freetalk.faces.views import SurfaceViews
from freetalk.geometry import Alignment

__all__ = [
    "MARKS",
    "FoundLandmarks",
    "NoFaceError",
    "available",
    "find_landmarks",
    "home_pose",
    "marked_landmarks",
]


class NoFaceError(ValueError):
    """Nothing on the mesh looks like a face."""


def find_landmarks(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    alignment: Alignment,
    *,
    pictures: bool | None = None,
    name: str = "the mesh",
) -> FoundLandmarks:
    """The 68 landmarks of the face on a mesh.

    Args:
        vertices: (V, 3) any unit and pose.
        faces: (F, 3) triangles.
        alignment: what ``freetalk.geometry.align_to_template`` finds; looked at first.
        pictures: look at the mesh (True), or ask its shape alone (False); by default as the extra is installed.
        name: of the mesh, for messages.

    Returns:
        Places on the surface with confidences, and the pose. Where pictures show a face, they and the shape count;
        where they show none, the shape alone, if it looks like a face.

    Raises:
        NoFaceError: neither pictures nor shape look like a face.
        RuntimeError: pictures were asked for and cannot be made.
    """
    hint = alignment.to_canonical
    if available() if pictures is None else pictures:
        model = built_in_face()
        with SurfaceViews(vertices, faces) as views:
            seen = search(
                views,
                detector(),
                np.asarray(model.neutral, dtype=np.float64)[model.landmarks],
                hint if alignment.face_like else None,
            )
        if seen is not None:
            return seen_landmarks(vertices, faces, seen)
        looked = "is seen on it from any side"
    else:
        looked = f"fits its shape (looking at pictures of it is more certain: {INSTALL})"
    if not alignment.face_like:
        raise NoFaceError(
            f"{name} does not look like a face: none {looked}; if it is one, say where: give its "
            "landmarks, or unit, up and forward"
        )
    return geometric_landmarks(vertices, faces, hint)
