from __future__ import annotations
import freetalk._native.geometry
import numpy
import numpy.typing
import torch
import typing

__all__: list[str] = [
    "AdaptiveOptions",
    "AdaptiveReport",
    "DecodeOptions",
    "FollowOptions",
    "FrameDecoder",
    "LandmarkCarrier",
    "LandmarkFollower",
    "MeshFeatures",
    "StmImpl",
    "StmOptions",
    "decode_adaptively",
    "landmark_adjacency",
    "landmark_edges",
    "landmark_mirror",
]

class StmOptions:
    """
    Options of STM [FreeTalk 3.2].
    """

    __hash__: typing.ClassVar[None] = None
    attention_dim: typing.Any
    attention_heads: typing.Any
    decoder: typing.Any
    decoder_blocks: typing.Any
    decoder_width: typing.Any
    displacement_scale: typing.Any
    dropout: typing.Any
    encoder_blocks: typing.Any
    encoder_width: typing.Any
    extractor: typing.Any
    feature_dim: typing.Any
    follows_landmarks: typing.Any
    fusion: typing.Any
    gcn_hidden: typing.Any
    gcn_layers: typing.Any
    index_code_dim: typing.Any
    k_eig: typing.Any
    length_scale: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> StmOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: StmOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class MeshFeatures:
    """
    What STM computes of a mesh once.
    """
    @property
    def hidden(self) -> torch.Tensor: ...
    @property
    def queries(self) -> torch.Tensor: ...

class StmImpl:
    def __init__(self, options: StmOptions) -> None: ...
    def attention(self, mesh: MeshFeatures, landmarks: torch.Tensor) -> torch.Tensor: ...
    def decode(
        self,
        mesh: MeshFeatures,
        operators: freetalk._native.geometry.SurfaceOperators,
        landmarks: torch.Tensor,
    ) -> torch.Tensor: ...
    def encode(
        self, positions: torch.Tensor, operators: freetalk._native.geometry.SurfaceOperators
    ) -> MeshFeatures: ...
    def forward(
        self,
        positions: torch.Tensor,
        operators: freetalk._native.geometry.SurfaceOperators,
        landmarks: torch.Tensor,
    ) -> torch.Tensor: ...
    def frames_per_chunk(
        self,
        num_vertices: typing.SupportsInt | typing.SupportsIndex,
        memory_bytes: typing.SupportsInt | typing.SupportsIndex,
    ) -> int: ...
    def named_buffers(self) -> list[tuple[str, torch.Tensor]]: ...
    def named_parameters(self) -> list[tuple[str, torch.Tensor]]: ...
    def train(self, mode: bool) -> None: ...
    @property
    def options(self) -> StmOptions: ...
    @property
    def training(self) -> bool: ...

class DecodeOptions:
    """
    Precision and memory of FrameDecoder.
    """

    __hash__: typing.ClassVar[None] = None
    memory_bytes: typing.Any
    precision: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> DecodeOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: DecodeOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class FollowOptions:
    """
    How landmarks are followed.
    """

    __hash__: typing.ClassVar[None] = None
    coarsest: typing.Any
    detail: typing.Any
    far: typing.Any
    farthest: typing.Any
    finest: typing.Any
    guessed: typing.Any
    near: typing.Any
    noise: typing.Any
    range: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> FollowOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: FollowOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class LandmarkFollower:
    """
    What following the landmarks needs of a mesh.
    """
    def __init__(
        self,
        vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
        *,
        landmarks: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        normals: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        options: FollowOptions = ...,
    ) -> None: ...
    def apply(self, displacements: torch.Tensor, landmarks: torch.Tensor) -> torch.Tensor:
        """
        (T, V, 3) displacements that follow the landmarks, differentiable.
        """
    def to(self, device: typing.Any) -> LandmarkFollower:
        """
        A copy on a device.
        """
    @property
    def corners(self) -> torch.Tensor:
        """
        (68, 3) int64 vertices.
        """
    @property
    def lengths(self) -> torch.Tensor:
        """
        (V, 1) m: detail of the network's motion that is finer is taken out.
        """
    @property
    def num_followed(self) -> int:
        """
        Landmarks that are near the surface.
        """
    @property
    def reach(self) -> torch.Tensor:
        """
        (V, 1) in [0, 1].
        """
    @property
    def shares(self) -> torch.Tensor:
        """
        (68, 3) barycentric on them.
        """
    @property
    def weights(self) -> torch.Tensor:
        """
        (V, 68), 0 for landmarks that are not followed.
        """

class FrameDecoder:
    """
    STM's decoder for many frames of one mesh.
    """
    def __init__(
        self,
        model: StmImpl,
        mesh: MeshFeatures,
        *,
        operators: freetalk._native.geometry.SurfaceOperators,
        options: DecodeOptions = ...,
        follower: LandmarkFollower = None,
    ) -> None: ...
    def decode(self, landmarks: torch.Tensor) -> torch.Tensor:
        """
        (T, V, 3) displacements in metres.
        """

class LandmarkCarrier:
    """
    Carries the mean face's landmark motion to another face.
    """
    def __init__(
        self,
        vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        faces: typing.Annotated[numpy.typing.ArrayLike, numpy.int32, "[m, n]"],
        *,
        follower: LandmarkFollower,
        mean: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"],
        known: bool,
        decoder: FrameDecoder = None,
    ) -> None: ...
    def apply(self, landmarks: torch.Tensor) -> torch.Tensor:
        """
        (T, 68, 3) displacements of this face's landmarks, on the CPU.
        """
    @property
    def lid_clearance(self) -> typing.Annotated[list[float], "FixedSize(4)"]:
        """
        m at rest, of landmarks 37-41, 38-40, 43-47 and 44-46.
        """
    @property
    def lip_clearance(self) -> typing.Annotated[list[float], "FixedSize(3)"]:
        """
        m at rest, of landmarks 61-67, 62-66 and 63-65.
        """

class AdaptiveOptions:
    """
    Tolerances of decode_adaptively.
    """

    __hash__: typing.ClassVar[None] = None
    tolerance_mean: typing.Any
    tolerance_mm: typing.Any
    @staticmethod
    def from_dict(arg0: dict) -> AdaptiveOptions:
        """
        Options from a mapping; an unknown key is a ValueError naming the nearest known one.
        """
    def __eq__(self, arg0: AdaptiveOptions) -> bool: ...
    def __getstate__(self) -> tuple[str]: ...
    def __init__(self, **kwargs) -> None: ...
    def __repr__(self) -> str: ...
    def __setstate__(self, arg0: tuple) -> None: ...
    def to_dict(self) -> dict:
        """
        All fields by name.
        """

class AdaptiveReport:
    """
    What decode_adaptively decoded.
    """
    @property
    def decoded(self) -> int: ...
    @property
    def frames(self) -> int: ...
    @property
    def max_error_mm(self) -> float: ...
    @property
    def mean_error(self) -> float: ...

def decode_adaptively(
    decoder: FrameDecoder, landmarks: torch.Tensor, *, options: AdaptiveOptions = ...
) -> tuple[torch.Tensor, AdaptiveReport]: ...
def landmark_adjacency() -> torch.Tensor: ...
def landmark_edges() -> list[tuple[int, int]]: ...
def landmark_mirror() -> typing.Annotated[list[int], "FixedSize(68)"]: ...
