from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import os
import pathlib
import scipy.sparse
import torch
import typing

__all__: list[str] = [
    "AlignOptions",
    "Alignment",
    "Mesh",
    "OperatorOptions",
    "Similarity",
    "SurfaceOperators",
    "align_to_template",
    "cached_surface_operators",
    "connected_components",
    "cotan_laplacian",
    "default_cache_dir",
    "face_areas",
    "load_mesh",
    "lumped_mass",
    "sample_surface",
    "save_mesh",
    "surface_operators",
    "vertex_normals",
]

class Mesh:
    """
    A polygon mesh as its file has it, plus its triangles.
    """
    def __init__(
        self,
        vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        polygons: collections.abc.Sequence[
            collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
        ],
        *,
        texcoords: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] = ...,
        polygon_texcoords: collections.abc.Sequence[
            collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
        ] = [],
        name: str = "mesh",
    ) -> None: ...
    def __repr__(self) -> str: ...
    @property
    def face_polygon(self) -> list[int]:
        """
        (F,) the polygon each triangle was cut from.
        """
    @property
    def faces(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"]:
        """
        (F, 3) int32 triangles.
        """
    @property
    def name(self) -> str:
        """
        The file's name, for messages.
        """
    @name.setter
    def name(self, arg0: str) -> None: ...
    @property
    def polygon_texcoords(self) -> list[list[int]]:
        """
        Rows of texcoords of each polygon's corners.
        """
    @property
    def polygons(self) -> list[list[int]]:
        """
        Vertex indices of each polygon as in the file; empty if all are triangles.
        """
    @property
    def texcoords(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (Vt, 2) float64; (0, 2) without.
        """
    @property
    def vertices(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (V, 3) float64, the file's unit.
        """
    @vertices.setter
    def vertices(
        self, arg1: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]
    ) -> None: ...

class OperatorOptions:
    """
    What is computed of a surface, and how exactly.
    """

    __hash__: typing.ClassVar[None] = None
    k_eig: typing.Any
    laplacian: typing.Any
    regularization: typing.Any
    residual_tolerance: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> OperatorOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: OperatorOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class SurfaceOperators:
    """
    Mass, eigenbasis and gradients of a surface.
    """
    def __repr__(self) -> str: ...
    def scaled(self, factor: typing.SupportsFloat | typing.SupportsIndex) -> SurfaceOperators:
        """
        Operators of the same surface scaled uniformly.
        """
    def to(self, dtype: typing.Any, device: typing.Any = "cpu") -> SurfaceOperators:
        """
        A copy with another dtype and device.
        """
    def turned(self, rotation: torch.Tensor) -> SurfaceOperators:
        """
        Operators of the same surface turned by a rotation (3, 3).
        """
    @property
    def evals(self) -> torch.Tensor:
        """
        (K,) 1 / length^2, ascending.
        """
    @property
    def evecs(self) -> torch.Tensor:
        """
        (V, K) 1 / length, mass-orthonormal.
        """
    @property
    def frames(self) -> torch.Tensor:
        """
        (V, 3, 3) rows X, Y, normal.
        """
    @property
    def gradients(self) -> torch.Tensor:
        """
        (2V, V) sparse CSR: X, then Y components in the tangent frames.
        """
    @property
    def gradients_transposed(self) -> torch.Tensor:
        """
        (V, 2V) sparse CSR.
        """
    @property
    def mass(self) -> torch.Tensor:
        """
        (V,) length^2.
        """
    @property
    def normals(self) -> torch.Tensor:
        """
        (V, 3).
        """
    @property
    def residuals(self) -> torch.Tensor:
        """
        (K,) relative eigen-residuals.
        """

class AlignOptions:
    """
    What is known of a mesh's frame.
    """

    __hash__: typing.ClassVar[None] = None
    forward: typing.Any
    unit: typing.Any
    up: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> AlignOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: AlignOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Similarity:
    """
    x -> scale * rotation * x + translation.
    """
    def __init__(
        self,
        scale: typing.SupportsFloat | typing.SupportsIndex = 1.0,
        rotation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"] = ...,
        *,
        translation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ...,
    ) -> None: ...
    def apply(
        self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (N, 3) points moved.
        """
    def apply_vectors(
        self, vectors: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (N, 3) vectors turned and scaled, not translated.
        """
    def compose(self, first: Similarity) -> Similarity:
        """
        First `first`, then this.
        """
    def inverse(self) -> Similarity: ...
    @property
    def rotation(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 3]"]:
        """
        (3, 3).
        """
    @property
    def scale(self) -> float: ...
    @property
    def translation(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 1]"]:
        """
        (3,).
        """

class Alignment:
    """
    A mesh's way to the canonical frame.
    """
    def __repr__(self) -> str: ...
    @property
    def face_like(self) -> bool: ...
    @property
    def forward(self) -> str: ...
    @property
    def guessed(self) -> bool: ...
    @property
    def normal_degrees(self) -> float: ...
    @property
    def residual_m(self) -> float: ...
    @property
    def summary(self) -> str: ...
    @property
    def to_canonical(self) -> Similarity: ...
    @property
    def unit(self) -> str: ...
    @property
    def up(self) -> str: ...

def align_to_template(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    template_points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    template_normals: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    options: AlignOptions = ...,
) -> Alignment:
    """
    Brings a face or head of any unit and pose to a template's frame.
    """

def cached_surface_operators(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    options: OperatorOptions = ...,
    cache_dir: os.PathLike | str | bytes = ...,
    name: str = "mesh",
    max_bytes: typing.SupportsInt | typing.SupportsIndex = 4294967296,
) -> SurfaceOperators:
    """
    Operators of a surface, from the disk cache where they are there.
    """

def connected_components(
    num_vertices: typing.SupportsInt | typing.SupportsIndex,
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 1]"]:
    """
    (V,) component of each vertex.
    """

def cotan_laplacian(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    regularization: str = "relative",
) -> scipy.sparse.csc_matrix:
    """
    (V, V) cotangent Laplacian as a scipy sparse matrix, positive semi-definite.
    """

def default_cache_dir() -> pathlib.Path:
    """
    The folder of the disk cache.
    """

def face_areas(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    (F,) areas.
    """

def load_mesh(path: os.PathLike | str | bytes) -> Mesh:
    """
    Reads an OBJ, PLY, OFF or STL file.
    """

def lumped_mass(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    (V,) lumped mass.
    """

def sample_surface(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    num_points: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex = 0,
) -> tuple[
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
]:
    """
    Points and normals spread evenly over a surface.
    """

def save_mesh(path: os.PathLike | str | bytes, mesh: Mesh) -> None:
    """
    Writes an OBJ or PLY file atomically.
    """

def surface_operators(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    options: OperatorOptions = ...,
    name: str = "mesh",
) -> SurfaceOperators:
    """
    Operators of a surface, computed.
    """

def vertex_normals(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    (V, 3) unit vertex normals.
    """
