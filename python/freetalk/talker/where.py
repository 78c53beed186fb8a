"""Where the face of a mesh is: told by its landmarks, or found by looking at it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from freetalk.geometry import Alignment
from freetalk.mesh import Mesh
from freetalk.talker.placement import Placement

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

#: 68 vertices, 68 points (68, 3) in the mesh's own unit and axes, or a file that names them.
Landmarks: TypeAlias = "ArrayLike | str | os.PathLike[str]"


def place(mesh: Mesh, landmarks: Landmarks) -> Placement:
    """Where a face lies that is told by its landmarks.

    Raises:
        ValueError: other than 68 landmarks, or a vertex that the mesh lacks.
    """
    from freetalk.data import read_landmarks
    from freetalk.faces import home_pose

    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if isinstance(landmarks, str | os.PathLike):
        found = read_landmarks(Path(landmarks), faces, len(vertices))
        points = np.einsum("kcd,kc->kd", vertices[found.vertices], found.weights.astype(np.float64))
    else:
        given = np.asarray(landmarks)
        if given.shape == (68,) and given.dtype.kind in "iu":
            if given.min() < 0 or given.max() >= len(vertices):
                raise ValueError(
                    f"landmarks name vertices from {given.min()} to {given.max()}, {mesh.name} has "
                    f"{len(vertices)}"
                )
            given = vertices[given]
        if given.shape != (68, 3) or not np.isfinite(given).all():
            raise ValueError(
                f"landmarks must be 68 vertices or points (68, 3), found {given.dtype} {given.shape}"
            )
        points = given.astype(np.float64)
    pose = home_pose(points, np.ones(len(points)))
    return Placement(mesh, pose, pose.apply(points), "landmarks as given", guessed=False)


def find_face(mesh: Mesh, alignment: Alignment) -> Placement:
    """Where the face of a mesh is whose shape leaves that in doubt.

    Raises:
        ValueError: nothing on it looks like a face.
    """
    from freetalk.faces import find_landmarks, home_pose

    found = find_landmarks(
        np.asarray(mesh.vertices), np.asarray(mesh.faces), alignment, name=mesh.name
    )
    pose = home_pose(found.positions, found.confidence)
    return Placement(mesh, pose, pose.apply(found.positions), found.summary, guessed=True)
