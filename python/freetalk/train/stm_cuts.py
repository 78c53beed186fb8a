"""Random crops and missing triangles of training faces: a user's mesh ends anywhere and has holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freetalk.data import FaceMesh

_SEED = 60
#: The crop's centre lies this far above the middle of the lips (m): between nose and eyes.
_ABOVE_LIPS_M = 0.03
#: Half axes of the crops (m): width, height, depth. The least one keeps brows, chin and cheeks.
_LEAST_M = np.array([0.065, 0.095, 0.08])
_MOST_M = np.array([0.115, 0.160, 0.200])


@dataclass(frozen=True)
class FaceCuts:
    """Which faces lose parts, and how much.

    Attributes:
        crops: share of the faces that are cropped at random around eyes, nose and mouth.
        missing_faces: largest share of a cropped face's triangles that is taken away one by one.
        least_vertices: a face of which fewer would be left stays whole: an eigenbasis needs them.
    """

    crops: float = 0.0
    missing_faces: float = 0.0
    least_vertices: int = 3

    def of(
        self, mesh: FaceMesh, index: int
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]] | None:
        """What is left of the `index`-th face, always the same for the same face.

        Returns:
            Kept vertices (V',) in ascending order and faces (F', 3) of them; None where the face
            stays whole: it is not among those cropped, its lips are unknown, or it is too small.
        """
        rng = np.random.default_rng([_SEED, index])
        if rng.random() >= self.crops or not mesh.lip_mask.any():
            return None
        faces = mesh.faces[_inside(mesh, rng)[mesh.faces].all(axis=1)]
        missing = rng.uniform(0.0, self.missing_faces)
        faces = faces[rng.random(len(faces)) >= missing]
        kept, corners = np.unique(faces, return_inverse=True)
        return (kept, corners.reshape(-1, 3)) if len(kept) >= self.least_vertices else None


def _inside(mesh: FaceMesh, rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """(V,) vertices inside a drawn superellipsoid, whose outline runs from an oval to a rounded box."""
    centre = mesh.vertices[mesh.lip_mask].mean(axis=0) + np.array([0.0, _ABOVE_LIPS_M, 0.0])
    half_axes = rng.uniform(_LEAST_M, _MOST_M)
    power = rng.uniform(2.0, 6.0)
    reach = (np.abs((mesh.vertices - centre) / half_axes) ** power).sum(axis=1)
    return reach < 1.0
