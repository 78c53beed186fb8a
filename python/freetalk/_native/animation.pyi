from __future__ import annotations
import collections.abc
import freetalk._native.audio
import freetalk._native.mesh
import numpy
import numpy.typing
import os
import torch
import typing

__all__: list[str] = [
    "Animation",
    "BlendShapes",
    "MeshFrame",
    "Part",
    "PartMotion",
    "Parts",
    "SaveOptions",
    "SaveReport",
    "fit_jaw",
    "load_gltf",
    "load_npz",
    "load_pc2",
    "load_sequence",
    "morph_basis",
    "resample_motion",
]

class MeshFrame:
    """
    How the mesh's unit and axes lie in the world.
    """
    @property
    def metres_per_unit(self) -> float: ...
    @property
    def to_y_up(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 3]"]:
        """
        (3, 3) mesh axes -> +Y up, +Z out.
        """

class SaveReport:
    """
    What was written.
    """

    format: str
    def __init__(self, format: str) -> None: ...
    @property
    def into_source(self) -> bool: ...
    @property
    def morph_error_mm(self) -> float: ...
    @property
    def num_files(self) -> int: ...
    @num_files.setter
    def num_files(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def num_morph_targets(self) -> int: ...

class BlendShapes:
    """
    Named targets and their weights over time.
    """
    def __init__(
        self, names: collections.abc.Sequence[str], targets: torch.Tensor, weights: torch.Tensor
    ) -> None: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def targets(self) -> torch.Tensor:
        """
        (K, V, 3) float32, mesh's unit.
        """
    @property
    def weights(self) -> torch.Tensor:
        """
        (T, K) float32 in [0, 1].
        """

class SaveOptions:
    """
    How an animation is written.
    """

    __hash__: typing.ClassVar[None] = None
    compact: typing.Any
    format: typing.Any
    max_morph_targets: typing.Any
    morph_tolerance_mm: typing.Any
    normals: typing.Any
    sound: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SaveOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SaveOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Animation:
    """
    A mesh, its displacements over time, and the speech.
    """

    metadata_json: str
    def __init__(
        self,
        mesh: freetalk._native.mesh.Mesh,
        displacements: torch.Tensor,
        *,
        fps: typing.SupportsFloat | typing.SupportsIndex = 30.0,
        audio: freetalk._native.audio.Audio | None = None,
        metadata_json: str = "{}",
        metres_per_unit: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        to_y_up: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"] = ...,
        head: torch.Tensor | None = None,
        landmarks: torch.Tensor | None = None,
    ) -> None: ...
    def save(
        self,
        path: os.PathLike | str | bytes,
        options: SaveOptions = ...,
        shapes: BlendShapes = ...,
        progress: collections.abc.Callable[[float], None] | None = None,
    ) -> SaveReport: ...
    def vertices_at(
        self, frame_index: typing.SupportsInt | typing.SupportsIndex
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def audio(self) -> freetalk._native.audio.Audio: ...
    @property
    def displacements(self) -> torch.Tensor:
        """
        (T, V, 3) float32.
        """
    @property
    def duration_s(self) -> float: ...
    @property
    def fps(self) -> float: ...
    @property
    def frame(self) -> MeshFrame: ...
    @property
    def head(self) -> torch.Tensor | None:
        """
        (T, 4, 4) float64 rigid motion of the mesh, None without.
        """
    @property
    def landmarks(self) -> torch.Tensor | None:
        """
        (T, 68, 3) float32, metres, canonical frame; None where not known.
        """
    @property
    def mesh(self) -> freetalk._native.mesh.Mesh: ...
    @property
    def num_frames(self) -> int: ...

class PartMotion:
    """
    What a part moves with.

    Members:

      FACE

      SURFACE

      JAW

      STILL
    """

    FACE: typing.ClassVar[PartMotion]
    JAW: typing.ClassVar[PartMotion]
    STILL: typing.ClassVar[PartMotion]
    SURFACE: typing.ClassVar[PartMotion]
    __members__: typing.ClassVar[dict[str, PartMotion]]
    def __eq__(self, other: typing.Any) -> bool: ...
    def __getstate__(self) -> int: ...
    def __hash__(self) -> int: ...
    def __index__(self) -> int: ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __int__(self) -> int: ...
    def __ne__(self, other: typing.Any) -> bool: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def __str__(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def value(self) -> int: ...

class Part:
    """
    One component of a mesh.
    """
    @property
    def motion(self) -> PartMotion: ...
    @property
    def num_vertices(self) -> int: ...

class Parts:
    """
    Which parts of a head mesh move, and with what.
    """
    def __init__(
        self,
        vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
        landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    ) -> None: ...
    def move(self, face_displacements: torch.Tensor, landmarks: torch.Tensor) -> torch.Tensor: ...
    def summary(self) -> str: ...
    @property
    def face_faces(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"]: ...
    @property
    def face_vertices(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]: ...
    @property
    def jaw_share(self) -> list[float]: ...
    @property
    def part_of_vertex(self) -> list[int]: ...
    @property
    def parts(self) -> list[Part]: ...

def fit_jaw(
    rest_landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    displacements: torch.Tensor,
) -> list[
    tuple[
        typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 3]"],
        typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 1]"],
    ]
]: ...
def load_gltf(
    path: os.PathLike | str | bytes, fps: typing.SupportsFloat | typing.SupportsIndex = 0.0
) -> Animation: ...
def load_npz(path: os.PathLike | str | bytes) -> Animation: ...
def load_pc2(
    path: os.PathLike | str | bytes,
    mesh: freetalk._native.mesh.Mesh,
    fps: typing.SupportsFloat | typing.SupportsIndex = 30.0,
) -> Animation: ...
def load_sequence(
    folder: os.PathLike | str | bytes, fps: typing.SupportsFloat | typing.SupportsIndex = 30.0
) -> Animation: ...
def morph_basis(
    displacements: torch.Tensor,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
    max_targets: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[torch.Tensor, torch.Tensor, float]: ...
def resample_motion(
    motion: torch.Tensor,
    from_fps: typing.SupportsFloat | typing.SupportsIndex,
    to_fps: typing.SupportsFloat | typing.SupportsIndex,
    num_frames: typing.SupportsInt | typing.SupportsIndex,
    landmarks: torch.Tensor | None = None,
) -> torch.Tensor: ...
