from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import os
import pathlib
import typing

__all__: list[str] = [
    "Appearance",
    "Budgeted",
    "LipSlit",
    "Mesh",
    "MeshReport",
    "Reshaped",
    "SlitOptions",
    "boundary_loops",
    "close_holes",
    "connected_components",
    "cut_lips",
    "face_areas",
    "lips_are_joined",
    "load_appearance",
    "load_mesh",
    "mesh_report",
    "save_mesh",
    "to_vertex_budget",
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
    def source(self) -> pathlib.Path:
        """
        The file it was read from, whose materials writers keep; empty without.
        """
    @source.setter
    def source(self, arg0: os.PathLike | str | bytes) -> None: ...
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

class Appearance:
    """
    How the surface of a mesh file looks.
    """
    def carried(
        self,
        polygon_origin: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        colours: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    ) -> Appearance:
        """
        The same on a mesh whose polygons look like those (-1: like none), vertices like that.
        """
    def with_parts(
        self,
        num_polygons: typing.SupportsInt | typing.SupportsIndex,
        materials: collections.abc.Sequence[
            tuple[str, typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"]]
        ],
        polygon_material: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        num_vertices: typing.SupportsInt | typing.SupportsIndex,
    ) -> Appearance:
        """
        The same of a mesh of so many polygons to which others of further materials (name, linear colour) were added, and so many vertices.
        """
    @property
    def colours(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (V, 4) of the vertices in [0, 1], sRGB; empty without.
        """
    @property
    def polygon_material(self) -> list[int]:
        """
        (P,) of each polygon, -1 for none; empty without materials.
        """

class MeshReport:
    """
    What a mesh is like, defect by defect.
    """
    def findings(self) -> list[str]:
        """
        One line a finding, worst first.
        """
    @property
    def boundaries(self) -> int:
        """
        Rims of boundary edges.
        """
    @property
    def boundary_edges(self) -> int:
        """
        Of one polygon.
        """
    @property
    def coincident_vertices(self) -> int:
        """
        At the place of an earlier vertex.
        """
    @property
    def duplicate_polygons(self) -> int:
        """
        With the vertices of an earlier one.
        """
    @property
    def edges(self) -> int: ...
    @property
    def extent(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 1]"]:
        """
        (3,) of the referenced vertices, file's unit.
        """
    @property
    def inconsistent_edges(self) -> int:
        """
        Whose two polygons turn opposite ways.
        """
    @property
    def larger_polygons(self) -> int:
        """
        Of more than three corners.
        """
    @property
    def lines_and_points(self) -> int:
        """
        Not kept: no faces.
        """
    @property
    def nonmanifold_edges(self) -> int:
        """
        Of three or more.
        """
    @property
    def nonmanifold_vertices(self) -> int:
        """
        Where surfaces touch in a point only.
        """
    @property
    def parts(self) -> int:
        """
        Connected by common vertices.
        """
    @property
    def polygons(self) -> int: ...
    @property
    def repeated_corner_polygons(self) -> int:
        """
        That name a vertex twice.
        """
    @property
    def triangles(self) -> int:
        """
        After polygons are cut.
        """
    @property
    def unreferenced_vertices(self) -> int:
        """
        In no face.
        """
    @property
    def vertices(self) -> int: ...
    @property
    def zero_area_triangles(self) -> int: ...

class SlitOptions:
    """
    How cut_lips cuts.
    """

    __hash__: typing.ClassVar[None] = None
    corridor: typing.Any
    depth: typing.Any
    edge: typing.Any
    gap: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> SlitOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: SlitOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class Reshaped:
    """
    A mesh made of another one.
    """
    @property
    def mesh(self) -> Mesh:
        """
        Old vertices in their order, then new ones.
        """
    @property
    def polygon_origin(self) -> list[int]:
        """
        (P',) the given polygon whose look each has.
        """
    @property
    def vertex_origin(self) -> list[tuple[int, int, float]]:
        """
        Of each new vertex (a, b, share): it looks like (1 - share) a + share b, those given and earlier ones.
        """

class LipSlit(Reshaped):
    """
    A mesh whose lips were cut apart.
    """
    @property
    def edges(self) -> int:
        """
        Of the slit.
        """
    @property
    def pocket_polygons(self) -> int:
        """
        The last ones: the pocket's.
        """
    @property
    def pocket_vertices(self) -> int:
        """
        The last ones: the pocket's.
        """

class Budgeted(Reshaped):
    """
    A mesh of about as many vertices as wanted.
    """
    @property
    def vertex_map(self) -> list[int]:
        """
        (V,) the new vertex of each old one, -1 where it is gone.
        """

def boundary_loops(
    polygons: collections.abc.Sequence[
        collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ],
) -> list[list[int]]:
    """
    The simple loops of edges of one polygon only, as vertices in the polygons' direction.
    """

def close_holes(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    *,
    max_edges: typing.SupportsInt | typing.SupportsIndex = 9223372036854775807,
) -> tuple[
    typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"],
    typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, n]"],
    int,
]:
    """
    (V + H, 3) vertices, (F', 3) faces and the number of edges that stay open.
    """

def connected_components(
    num_vertices: typing.SupportsInt | typing.SupportsIndex,
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 1]"]:
    """
    (V,) component of each vertex.
    """

def cut_lips(
    mesh: Mesh,
    landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    *,
    options: SlitOptions = ...,
) -> LipSlit:
    """
    Cuts a slit between lips that are one skin and sews a pocket behind it.
    """

def face_areas(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    (F,) areas.
    """

def lips_are_joined(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
    landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
) -> bool:
    """
    Whether upper and lower lip are one skin.
    """

def load_appearance(mesh: Mesh) -> Appearance:
    """
    Materials, textures and colours of the file that a mesh was read from.
    """

def load_mesh(path: os.PathLike | str | bytes) -> Mesh:
    """
    Reads an OBJ, PLY, OFF, STL or glTF file.
    """

def mesh_report(mesh: Mesh) -> MeshReport:
    """
    What a mesh is like, defect by defect.
    """

@typing.overload
def save_mesh(path: os.PathLike | str | bytes, mesh: Mesh) -> None:
    """
    Writes an OBJ or PLY file atomically.
    """

@typing.overload
def save_mesh(path: os.PathLike | str | bytes, mesh: Mesh, appearance: Appearance) -> None:
    """
    The same with the look of the surface.
    """

def to_vertex_budget(
    mesh: Mesh,
    vertices: typing.SupportsInt | typing.SupportsIndex,
    importance: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] = ...,
) -> Budgeted:
    """
    Thins a mesh out or halves its edges until it has about as many vertices.
    """

def vertex_normals(
    vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
    faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    (V, 3) unit vertex normals.
    """
