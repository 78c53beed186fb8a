"""Motion whose frames are scans: meshes of their own each, no vertex of which is known in another.

Of each frame the packed layout keeps as many points of its surface (``scans.npy``), spread evenly over its area, and of
each speaker the neutral scan, whose vertices a network moves until its surface lies on the points. On disk they are

======================  =====================================================================
``motion/NAME.npy``     (T, 68, 3) landmarks of a take's scans
``scans/NAME/*.ply``    T meshes, in the order of their names
``templates/WHO.npy``   (68, 3) landmarks of a speaker's neutral scan
``scans/WHO.ply``       the neutral scan
======================  =====================================================================

all in one place: the head's own motion taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from freetalk.data.errors import DatasetError, LayoutError, MissingFileError
from freetalk.data.pack import Array, FloatArray
from freetalk.data.pose import Pose
from freetalk.data.templates import MESH_SUFFIXES, read_mesh
from freetalk.geometry import sample_template

#: Points that are kept of a frame: about 4 mm apart on a head, 2 mm on a face.
NUM_POINTS = 8192
#: A landmark of the neutral face that is farther from the neutral scan belongs to another one (m).
_ASTRAY_M = 0.01

Mesh = tuple[FloatArray, npt.NDArray[np.int64]]


def scan_files(folder: Path) -> tuple[Path, ...]:
    """The meshes of a take, in the order of their names.

    Raises:
        MissingFileError: there are none.
    """
    listed = sorted(folder.iterdir()) if folder.is_dir() else []
    found = tuple(path for path in listed if path.suffix.lower() in MESH_SUFFIXES)
    if not found:
        raise MissingFileError(f"{folder} holds no scans ({', '.join(MESH_SUFFIXES)})")
    return found


def neutral_scans(folder: Path) -> dict[str, Mesh]:
    """Vertices and triangles of each speaker's neutral scan; empty where there is no such folder.

    Raises:
        MissingFileError: it holds none.
    """
    return {path.stem: read_mesh(path) for path in scan_files(folder)} if folder.is_dir() else {}


def sampled_scans(
    paths: Sequence[Path], wanted: int, pose: Pose, origin: FloatArray, num_points: int = NUM_POINTS
) -> Array:
    """(T, P, 3) float16, m: points of the surface of each frame, in the canonical frame.

    Args:
        paths: of all frames of the take.
        wanted: frames of its landmarks.
        pose: from the files' coordinates to ours.
        origin: (3,) where ours begin, in the files' unit.
        num_points: P.

    Raises:
        LayoutError: other frames than the landmarks have.
        DatasetError: a scan cannot be read, or has no surface.
    """
    if len(paths) != wanted:
        raise LayoutError(
            f"{paths[0].parent} holds {len(paths)} scans, its landmarks are of {wanted} frames"
        )
    frames = []
    for number, path in enumerate(paths):
        vertices, faces = read_mesh(path)
        if len(faces) == 0:
            raise DatasetError(f"{path} has no triangles: give the scan's surface")
        points, _ = sample_template(vertices, faces, num_points, seed=number)
        frames.append(pose.apply(points - origin).astype(np.float16))
    return np.stack(frames)


def scan_arrays(
    name: str, scan: Mesh, marks: FloatArray, pose: Pose, origin: FloatArray
) -> dict[str, Array]:
    """The arrays of a speaker's neutral scan as a meshing, with the vertices nearest to the landmarks.

    Args:
        name: of the speaker.
        scan: in the file's coordinates.
        marks: (68, 3) landmarks, canonical frame, m.
        pose: from the files' coordinates to ours.
        origin: (3,) where ours begin, in the files' unit.

    Raises:
        DatasetError: landmarks lie off the scan.
    """
    vertices = pose.apply(scan[0] - origin).astype(np.float32)
    distance, nearest = cKDTree(vertices).query(marks)
    if distance.max() > _ASTRAY_M:
        raise DatasetError(
            f"landmark {distance.argmax()} of {name} is {1000 * distance.max():.0f} mm away from every vertex of "
            "the neutral scan: they are not of one place and unit"
        )
    nowhere = np.zeros(len(vertices), bool)
    return {
        "neutral": vertices,
        "faces": scan[1].astype(np.int32),
        "identity_basis": np.zeros((0, *vertices.shape), np.float32),
        "landmarks": np.asarray(nearest, np.int64),
        "lip_mask": nowhere,
        "upper_face_mask": nowhere,
    }
