from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import os
import scipy.sparse
import torch
import typing

__all__: list[str] = [
    "AlignOptions",
    "Alignment",
    "Eigenbasis",
    "EigenbasisOptions",
    "FaceOperators",
    "OperatorOptions",
    "Similarity",
    "SparseOperator",
    "SurfaceOperators",
    "SurfaceTree",
    "align_to_template",
    "cached_surface_operators",
    "concatenate",
    "cotan_laplacian",
    "eigenbasis",
    "face_operators",
    "isosurface",
    "isosurface_of_cells",
    "lumped_mass",
    "point_cloud_laplacian",
    "robust_laplacian",
    "sample_surface",
    "surface_operators",
    "unique_edges",
]

class SparseOperator:
    """
    A constant sparse matrix (R, V) and its transpose by compressed rows, for sparse_product.

    torch's own and scipy's matrices share its memory: ``matrix.to_sparse_csr()`` and
    ``scipy.sparse.csr_array((matrix.values, matrix.columns, matrix.rows), matrix.shape)``.
    """
    def __getstate__(self) -> tuple: ...
    def __init__(self, matrix: torch.Tensor) -> None:
        """
        Of a matrix (R, V), dense or of any of torch's sparse layouts.
        """
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def tensors(self) -> tuple:
        """
        (rows, columns, values) of the matrix, then of its transpose: what the operation
        torch.ops.freetalk.sparse_product takes before x, under torch.compile for instance.
        """
    def to(self, dtype: typing.Any, device: typing.Any = "cpu") -> SparseOperator:
        """
        A copy with another dtype and device.
        """
    def to_dense(self) -> torch.Tensor:
        """
        (R, V).
        """
    def to_sparse_csr(self) -> torch.Tensor:
        """
        torch's sparse CSR tensor (R, V), nothing copied.
        """
    def transposed(self) -> SparseOperator:
        """
        (V, R), nothing copied.
        """
    @property
    def columns(self) -> torch.Tensor:
        """
        (N,).
        """
    @property
    def rows(self) -> torch.Tensor:
        """
        (R + 1,) first entry of each row, and the end; int32 or int64.
        """
    @property
    def shape(self) -> tuple[int, int]: ...
    @property
    def values(self) -> torch.Tensor:
        """
        (N,).
        """

class FaceOperators:
    """
    Gradients and Poisson solver on triangles.
    """
    @property
    def areas(self) -> torch.Tensor:
        """
        (F,) length^2.
        """
    @property
    def components(self) -> torch.Tensor:
        """
        (V,) int64, connected part of each vertex.
        """
    @property
    def faces(self) -> torch.Tensor:
        """
        (F, 3) int64.
        """
    @property
    def frames(self) -> torch.Tensor:
        """
        (F, 3, 3) rows X, Y, normal.
        """
    @property
    def gradients(self) -> SparseOperator:
        """
        (2F, V): X, then Y components in the faces' tangent frames.
        """

class OperatorOptions:
    """
    What is computed of a surface, and how exactly.
    """

    __hash__: typing.ClassVar[None] = None
    k_eig: typing.Any
    laplacian: typing.Any
    regularization: typing.Any
    residual_tolerance: typing.Any
    weld: typing.Any
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
    def faces(self) -> FaceOperators:
        """
        What lives on the faces: gradients and the Poisson solver.
        """
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
    def gradients(self) -> SparseOperator:
        """
        (2V, V): X, then Y components in the tangent frames.
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
    def offsets(self) -> list[int]:
        """
        First vertex of each mesh of a batch and the end; empty for one mesh.
        """
    @property
    def residuals(self) -> torch.Tensor:
        """
        (K,) relative eigen-residuals.
        """

class EigenbasisOptions:
    """
    How many eigenpairs, how exactly, by which solver.
    """

    __hash__: typing.ClassVar[None] = None
    k: typing.Any
    solver: typing.Any
    tolerance: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> EigenbasisOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: EigenbasisOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Eigenbasis:
    """
    The smallest eigenpairs of a Laplacian.
    """
    def __repr__(self) -> str: ...
    @property
    def evals(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        (K,) ascending, 1 / length^2.
        """
    @property
    def evecs(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (V, K) mass-orthonormal, 1 / length.
        """
    @property
    def residuals(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        (K,) relative eigen-residuals.
        """

class SurfaceTree:
    """
    A triangle mesh made ready for nearest points.
    """
    def __init__(
        self,
        vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    ) -> None: ...
    def nearest(
        self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]
    ) -> tuple[
        typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
        typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"],
        typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 1]"],
    ]:
        """
        (N, 3) nearest points of the surface, (N,) distances, (N,) faces.
        """
    def signed_distance(
        self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        (N,) distance, negative where the winding number is at least 1/2.
        """
    def winding_number(
        self,
        points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        *,
        accuracy: typing.SupportsFloat | typing.SupportsIndex = 2.0,
    ) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        (N,) how often the surface winds around each point.
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
    progress: collections.abc.Callable[[float], None] | None = None,
) -> SurfaceOperators:
    """
    Operators of a surface, from the disk cache where they are there.
    """

def concatenate(parts: collections.abc.Sequence[SurfaceOperators]) -> SurfaceOperators:
    """
    Operators of several meshes as one block-diagonal batch.
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

def eigenbasis(
    laplacian: scipy.sparse.csc_matrix,
    mass: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"],
    *,
    options: EigenbasisOptions = ...,
    name: str = "mesh",
    progress: collections.abc.Callable[[float], None] | None = None,
) -> Eigenbasis:
    """
    The smallest eigenpairs of L phi = lambda M phi.
    """

def face_operators(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    vertex_of: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, 1]"] = ...,
) -> FaceOperators:
    """
    Gradients on the faces of a mesh and its Poisson solver, float64.
    """

def isosurface(
    values: typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
    *,
    level: typing.SupportsFloat | typing.SupportsIndex = 0.0,
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ...,
    spacing: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ...,
) -> tuple[
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
    typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"],
]:
    """
    (V, 3) vertices and (F, 3) faces of a level of a field (X, Y, Z).
    """

def isosurface_of_cells(
    corners: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    values: typing.Annotated[numpy.typing.ArrayLike, numpy.float32, "[m, 1]"],
    *,
    cells: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, 8]"],
    level: typing.SupportsFloat | typing.SupportsIndex = 0.0,
) -> tuple[
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
    typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"],
]:
    """
    (V, 3) vertices and (F, 3) faces of a level of a field within chosen cells.
    """

def lumped_mass(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    (V,) lumped mass.
    """

def point_cloud_laplacian(
    points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    *,
    mollify_factor: typing.SupportsFloat | typing.SupportsIndex = 1e-05,
    num_neighbors: typing.SupportsInt | typing.SupportsIndex = 30,
    published_fit: bool = True,
) -> tuple[
    scipy.sparse.csc_matrix, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]
]:
    """
    (V, V) tufted Laplacian of points as a scipy sparse matrix, and (V,) mass.
    """

def robust_laplacian(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    mollify_factor: typing.SupportsFloat | typing.SupportsIndex = 1e-05,
) -> tuple[
    scipy.sparse.csc_matrix, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]
]:
    """
    (V, V) tufted Laplacian of triangles as a scipy sparse matrix, and (V,) mass.
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

def surface_operators(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    options: OperatorOptions = ...,
    name: str = "mesh",
    progress: collections.abc.Callable[[float], None] | None = None,
) -> SurfaceOperators:
    """
    Operators of a surface, computed.
    """

def unique_edges(faces: torch.Tensor) -> torch.Tensor:
    """
    (E, 2) int64 unique undirected edges (i < j) of triangles.
    """
