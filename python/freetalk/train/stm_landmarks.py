"""Where the 68 landmarks are on training faces, as a user's mesh has them: known, found or guessed."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.corpus.linear_face import built_in_face
from freetalk.data import Dataset, FaceMesh
from freetalk.data.landmark_transfer import on_surface
from freetalk.data.triangles import Places
from freetalk.mesh import vertex_normals
from freetalk.stm import FollowOptions, LandmarkFollower

Points = npt.NDArray[np.float64]

#: Shares of the faces whose landmarks are known and found; of the others the mean face's are taken.
_KNOWN, _FOUND = 0.5, 0.3
#: Standard deviations of their places (m).
_KNOWN_M, _FOUND_M = 0.0004, 0.0015
#: Noise of the interpolation from the mean face's landmarks.
_GUESSED_NOISE = 0.05


class FaceLandmarks:
    """Places of landmarks on the faces of a dataset: its own, else those of the built-in face that it was made of.

    Attributes:
        mean: (68, 3) of the mean face, m.
        outward: (68, 3) its normals there.
    """

    def __init__(self, corpus: Dataset) -> None:
        self._corpus = corpus
        face = built_in_face()
        neutral = np.asarray(face.neutral, dtype=np.float64)
        self.mean = neutral[face.landmarks]
        self.outward = vertex_normals(neutral, face.faces)[face.landmarks]
        self._of_meshing: dict[str, Places] = {}

    def on(self, topology: str, mesh: FaceMesh) -> Places:
        """Those of a whole meshing; ``mesh`` is any of its faces."""
        if topology not in self._of_meshing:
            self._of_meshing[topology] = self._found(topology, mesh)
        return self._of_meshing[topology]

    def follower(
        self,
        vertices: npt.NDArray[Any],
        faces: npt.NDArray[Any],
        landmarks: Points,
        rng: np.random.Generator | None = None,
    ) -> LandmarkFollower:
        """What following needs of a face.

        Args:
            vertices: (V, 3) m.
            faces: (F, 3).
            landmarks: (68, 3) the true ones, m.
            rng: draws how well they are known; None: they are.
        """
        kind, options = 0.0 if rng is None else rng.random(), FollowOptions()
        places = landmarks
        if rng is not None and kind < _KNOWN + _FOUND:
            size = _KNOWN_M if kind < _KNOWN else _FOUND_M
            places = landmarks + size * rng.standard_normal(landmarks.shape)
        elif rng is not None:
            places, options = self.mean, FollowOptions(noise=_GUESSED_NOISE)
        return LandmarkFollower(
            np.asarray(vertices, np.float64),
            np.asarray(faces, np.int32),
            landmarks=places,
            normals=self.outward,
            options=options,
        )

    def _found(self, topology: str, mesh: FaceMesh) -> Places:
        if mesh.landmarks is not None:
            corners = np.repeat(mesh.landmarks[:, None], 3, axis=1)
            return Places(corners, np.tile([1.0, 0.0, 0.0], (len(corners), 1)))
        data = self._corpus.meshing(topology)
        neutral = data.neutral(np.zeros(0, np.float32)).astype(np.float64)
        triangles, shares, _, _ = on_surface(neutral, data.faces, self.mean, self.outward)
        return Places(data.faces[triangles], shares)
