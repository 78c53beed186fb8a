"""The meshing a dataset is registered to: its triangles, landmarks and regions, and who says so.

The landmark indices and masks of FLAME, BIWI_6 and Multiface come with licences of their own, so they
are files that the user brings: into the dataset's folder, or once for all datasets into
``$FREETALK_TEMPLATES/<template>`` (by default ``~/.config/freetalk/templates/<template>``). Every
result names each by file, count and hash.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freetalk.data.errors import DatasetError, MissingFileError, MissingLandmarksError
from freetalk.data.index_files import (
    SUFFIXES,
    FloatArray,
    Landmarks,
    Mask,
    index_hash,
    read_landmarks,
    read_mask,
)
from freetalk.data.safe_pickle import load_pickle
from freetalk.mesh import load_mesh

#: Template by number of vertices and triangles.
KNOWN_COUNTS: dict[tuple[int, int], str] = {
    (5023, 9976): "FLAME",
    (3895, 7539): "BIWI_6",
    (5471, 10837): "Multiface",
    (23370, 46068): "BIWI",
}
#: Hash of the triangles where it is known; other counts of triangles are another file of the mesh.
KNOWN_FACES: dict[str, str] = {"FLAME": "c495737954d54708", "BIWI": "575d645a7fda0577"}
#: Hash of landmark lists of public code.
KNOWN_LANDMARKS: dict[str, str] = {
    "0d62153ad4ff0a4c": "FLAME's static embedding and its jaw line at angle 0",
    "1e40b8108b41c29b": "FLAME, full_lmk of DECA's landmark_embedding.npy",
}

MESH_SUFFIXES = (".obj", ".ply", ".off", ".stl")
_FOLDERS = ("", "template", "templates", "flame_model", "regions")
_LANDMARK_NAMES = ("landmarks68", "landmarks", "landmark_embedding", "flame_static_embedding")
_LIP_NAMES = ("lip_mask", "lips", "mouth_indices", "FLAME_lips_idx", "lve")
_UPPER_NAMES = ("upper_mask", "upper_face_mask", "upper_indices", "fdd")
#: Regions of ``FLAME_masks.pkl``.
_REGIONS = {"lips": ("lips",), "upper": ("forehead", "eye_region")}


@dataclass(frozen=True)
class Template:
    """What is known of a meshing.

    Attributes:
        name: FLAME, BIWI_6, Multiface, or the name that the dataset gives it.
        faces: (F, 3) int64; (0, 3) where motion is landmarks alone.
        num_vertices: V.
        landmarks: the 68 landmarks, if a file says which.
        lip_mask: vertices of the lips, if a file says which.
        upper_face_mask: vertices of brows, eyes and forehead, if a file says which.
    """

    name: str
    faces: npt.NDArray[np.int64]
    num_vertices: int
    landmarks: Landmarks | None = None
    lip_mask: Mask | None = None
    upper_face_mask: Mask | None = None

    def needed_landmarks(self) -> Landmarks:
        """The landmarks.

        Raises:
            MissingLandmarksError: no file says which they are; where to put one.
        """
        if self.landmarks is None:
            raise MissingLandmarksError(
                f"which vertices of {self.name} ({self.num_vertices}) are the 68 landmarks? Put "
                f"landmarks68.json (or .npy, .txt: 68 indices in iBUG order) into the dataset's folder "
                f"or {templates_home() / self.name.lower()}; 'freetalk mesh landmarks TEMPLATE.ply' "
                "proposes them"
            )
        return self.landmarks

    def describe(self) -> dict[str, Any]:
        """Name, counts, and file, count and hash of each list, as results name them."""
        faces = index_hash(self.faces)
        known = KNOWN_FACES.get(self.name)
        lists = {
            "landmarks": self.landmarks,
            "lip_mask": self.lip_mask,
            "upper_face_mask": self.upper_face_mask,
        }
        described = {k: None if item is None else item.describe() for k, item in lists.items()}
        if described["landmarks"] is not None:
            known_as = KNOWN_LANDMARKS.get(described["landmarks"]["sha256"])
            described["landmarks"]["known_as"] = known_as
        return {
            "template": self.name,
            "vertices": self.num_vertices,
            "faces": {"count": len(self.faces), "sha256": faces, "recognised": known == faces},
            **described,
        }


def templates_home() -> Path:
    """Folder of the files that a user brings once for all datasets."""
    given = os.environ.get("FREETALK_TEMPLATES")
    if given:
        return Path(given)
    config = os.environ.get("XDG_CONFIG_HOME") or str(Path.home() / ".config")
    return Path(config) / "freetalk" / "templates"


def template_name(num_vertices: int, num_faces: int, otherwise: str) -> str:
    """Recognises a template by its counts."""
    return KNOWN_COUNTS.get((num_vertices, num_faces), otherwise)


def read_mesh(path: Path) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Vertices (V, 3) float32 and triangles (F, 3) of a mesh file, in the file's order.

    Raises:
        MissingFileError, DatasetError: no such file; no mesh.
    """
    if not path.is_file():
        raise MissingFileError(f"there is no mesh {path}")
    try:
        mesh = load_mesh(path)
    except RuntimeError as error:
        raise DatasetError(str(error)) from error
    vertices = np.asarray(mesh.vertices, dtype=np.float32)
    return vertices, np.asarray(mesh.faces, dtype=np.int64)


def read_faces(path: Path) -> tuple[dict[str, FloatArray], dict[str, npt.NDArray[np.int64]]]:
    """Neutral faces (V, 3) by speaker, and the triangles (F, 3) of those that are mesh files.

    Args:
        path: ``templates.pkl`` or ``.npz`` (speaker to array), a folder of meshes or ``.npy`` named after their
            speakers, or one mesh or ``.npy``, which is everyone's, under the name ``''``.

    Raises:
        MissingFileError, UnsafePickleError, DatasetError: not there, not plain, or no faces.
    """
    held: dict[str, Any] = {}
    faces: dict[str, npt.NDArray[np.int64]] = {}
    if path.suffix.lower() in (".pkl", ".npz"):
        content = load_pickle(path) if path.suffix.lower() == ".pkl" else np.load(path)
        if not hasattr(content, "items"):
            raise DatasetError(
                f"{path} holds {type(content).__name__}; expected speakers and their faces"
            )
        held = {str(name): np.asarray(points) for name, points in content.items()}
    else:
        files = {p.stem: p for p in sorted(path.iterdir())} if path.is_dir() else {"": path}
        for name, file in files.items():
            if file.suffix.lower() in MESH_SUFFIXES:
                held[name], faces[name] = read_mesh(file)
            elif file.suffix.lower() == ".npy" and file.is_file():
                held[name] = np.load(file, allow_pickle=False)
    for name, points in held.items():
        if points.dtype.kind != "f" or points.size % 3:
            raise DatasetError(
                f"{path}: the face {name} is {points.dtype} {points.shape}; expected (V, 3)"
            )
    if not held:
        raise DatasetError(f"{path} holds no neutral face (a mesh or .npy)")
    return {n: np.asarray(p, np.float32).reshape(-1, 3) for n, p in held.items()}, faces


def speaker_of(name: str, speakers: Collection[str]) -> str | None:
    """The longest speaker that a sequence's name begins with, as a whole word (``F1`` of ``F1_e37``)."""
    if "" in speakers:
        return ""
    fitting = [s for s in speakers if name == s or re.match(re.escape(s) + r"[^A-Za-z0-9]", name)]
    return max(fitting, key=len, default=None)


def find_template(
    directory: Path, faces: npt.NDArray[np.int64], num_vertices: int, otherwise: str
) -> Template:
    """Recognises the template and gathers the lists that the user brought for it.

    Args:
        directory: the dataset's folder, looked through first.
        faces: (F, 3) its triangles.
        num_vertices: V.
        otherwise: its name if it is none of the known ones.

    Raises:
        DatasetError, VertexCountError: a list is there, but wrong.
    """
    name = template_name(num_vertices, len(faces), otherwise)
    home = templates_home() / name.lower()
    folders = [directory / folder for folder in _FOLDERS] + [home]
    landmarks = _first(folders, _LANDMARK_NAMES)
    regions = _first(folders, ("FLAME_masks",)) if name == "FLAME" else None

    def mask(names: tuple[str, ...], key: str) -> Mask | None:
        path = _first(folders, names)
        if path is not None:
            return read_mask(path, num_vertices, (key, *_REGIONS[key]))
        return None if regions is None else read_mask(regions, num_vertices, _REGIONS[key])

    return Template(
        name=name,
        faces=faces,
        num_vertices=num_vertices,
        landmarks=None if landmarks is None else read_landmarks(landmarks, faces, num_vertices),
        lip_mask=mask(_LIP_NAMES, "lips"),
        upper_face_mask=mask(_UPPER_NAMES, "upper"),
    )


def find_template_mesh(directory: Path, name: str = "flame") -> Path | None:
    """The mesh file that gives a template its triangles, in the dataset's folder or the user's."""
    folders = [directory / folder for folder in _FOLDERS] + [templates_home() / name]
    names = ("FLAME_sample", "BIWI", "template", "head_template", "head_template_mesh")
    return _first(folders, names, (".ply", ".obj", ".off"))


def _first(
    folders: list[Path], names: tuple[str, ...], suffixes: tuple[str, ...] = SUFFIXES
) -> Path | None:
    for folder in folders:
        for name in names:
            for suffix in suffixes:
                if (folder / (name + suffix)).is_file():
                    return folder / (name + suffix)
    return None
