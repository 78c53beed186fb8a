"""The surface follows its landmarks: exactly where they are, smoothly around, not at all far away."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from sewn_lips import sewn_head

import freetalk
from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.corpus.linear_face import built_in_face
from freetalk.geometry import cotan_laplacian, lumped_mass, surface_operators
from freetalk.mesh import cut_lips, vertex_normals
from freetalk.stm import FollowOptions, LandmarkFollower, Stm

SHIPPED = Path(freetalk.__file__).parent / "pretrained" / "open-small"
FRAMES = 12


def follower_of(vertices: np.ndarray, faces: np.ndarray, **options: float) -> LandmarkFollower:
    face = built_in_face()
    neutral = np.asarray(face.neutral, np.float64)
    return LandmarkFollower(
        vertices,
        faces,
        landmarks=neutral[face.landmarks],
        normals=vertex_normals(neutral, face.faces)[face.landmarks],
        options=FollowOptions(**options),
    )


@pytest.fixture(scope="module")
def head() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3) m, faces and landmarks (68,) of the mean head, with neck and sockets."""
    model = load_face_model()
    vertices = model.neutral[: EXTENTS["sockets"]].astype(np.float64)
    return vertices, triangulate(crop_quads(model, "sockets")), model.landmarks68


@pytest.fixture(scope="module")
def follower(head: tuple[np.ndarray, np.ndarray, np.ndarray]) -> LandmarkFollower:
    return follower_of(*head[:2])


@pytest.fixture(scope="module")
def told() -> torch.Tensor:
    """Landmark motion that no face of the training makes: smooth over time, random from one to the next."""
    rng = np.random.default_rng(0)
    phases = 2 * np.pi * rng.random((1, 68, 3))
    times = np.arange(FRAMES)[:, None, None] / 30
    return torch.from_numpy((0.003 * np.sin(4 * times + phases)).astype(np.float32))


@pytest.fixture(scope="module")
def decoded(
    head: tuple[np.ndarray, np.ndarray, np.ndarray],
    follower: LandmarkFollower,
    told: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """What the shipped network gives, as it is and following (T, V, 3)."""
    stm = Stm.from_pretrained(SHIPPED / "stm").eval()
    vertices, faces, _ = head
    operators = surface_operators(
        vertices / stm.options.length_scale, faces, k=stm.options.k_eig, cache=False
    ).to(dtype=torch.float32)
    with torch.no_grad():
        features = stm.encode(torch.from_numpy(vertices).float(), operators)
    return (
        stm.frame_decoder(features, operators).decode(told),
        stm.frame_decoder(features, operators, follower=follower).decode(told),
    )


def test_landmarks_move_as_told_on_any_motion(
    head: tuple[np.ndarray, np.ndarray, np.ndarray],
    decoded: tuple[torch.Tensor, torch.Tensor],
    told: torch.Tensor,
) -> None:
    """Smooth or not: of random motion a twentieth is taken for noise where landmarks lie close together."""
    plain, following = (moved[:, head[2].tolist()] for moved in decoded)
    size = told.norm(dim=-1).mean()
    assert (plain - told).norm(dim=-1).mean() > 0.2 * size
    assert (following - told).norm(dim=-1).mean() < 0.05 * size


def test_expressions_of_a_face_move_the_landmarks_to_a_fiftieth(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], follower: LandmarkFollower
) -> None:
    model = load_face_model()
    names = ("jawOpen", "mouthPucker", "mouthSmile_L", "browInnerUp_L", "eyeBlink_R", "jawLeft")
    told = torch.from_numpy(model.landmark_basis[[model.index(name) for name in names]])
    still = torch.zeros(len(names), len(head[0]), 3)
    moved = follower.apply(still, told)[:, head[2].tolist()]
    assert (moved - told).norm(dim=-1).sum() < 0.02 * told.norm(dim=-1).sum()


def test_nothing_moves_far_from_the_landmarks(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], decoded: tuple[torch.Tensor, torch.Tensor]
) -> None:
    vertices, _, landmarks = head
    marks = vertices[landmarks]
    far = np.linalg.norm(vertices[:, None] - marks[None], axis=-1).min(axis=1) > 0.12
    lips = decoded[1][:, landmarks[48:].tolist()].norm(dim=-1).mean()
    assert far.any() and decoded[1][:, torch.from_numpy(far)].norm(dim=-1).max() <= 0.01 * lips


def test_following_adds_no_jerk(decoded: tuple[torch.Tensor, torch.Tensor]) -> None:
    """Per motion: following makes more motion of landmarks that the network ignored."""
    plain, following = (
        moved.diff(n=3, dim=0).norm(dim=-1).mean() / moved.norm(dim=-1).mean() for moved in decoded
    )
    assert following <= plain


def test_lips_part_without_pulling_each_other(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], follower: LandmarkFollower
) -> None:
    """Inner landmarks of the lower lip alone are moved: the upper lip stays."""
    told = torch.zeros(1, 68, 3)
    told[:, [55, 56, 57, 58, 59, 65, 66, 67], 1] = -0.01
    moved = follower.apply(torch.zeros(1, len(head[0]), 3), told)[0, :, 1]
    indices = head[2]
    assert (moved[indices[[61, 62, 63]].tolist()].abs() < 0.0005).all()
    assert (moved[indices[[65, 66, 67]].tolist()] < -0.009).all()


def test_a_landmark_off_the_mesh_is_not_followed(
    head: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    vertices, faces, landmarks = head
    above = vertices[:, 1] > vertices[landmarks[33], 1] - 0.005  # without mouth and chin
    used, corners = np.unique(faces[above[faces].all(axis=1)], return_inverse=True)
    cut = follower_of(vertices[used], corners.reshape(-1, 3))
    assert cut.num_followed < 60
    assert cut.weights[:, [8, 57]].abs().max() == 0 and cut.weights[:, 30].max() > 0.5
    assert follower_of(vertices, faces).num_followed == 68


def roughness(
    moved: torch.Tensor, vertices: np.ndarray, faces: np.ndarray, part: np.ndarray
) -> float:
    """Root mean square of the displacements' Laplacian over a part of the surface, its slivers aside."""
    laplacian = cotan_laplacian(vertices, faces)
    mass = lumped_mass(vertices, faces)
    part = part & (mass > 0.05 * np.median(mass))
    flat = moved.double().permute(1, 0, 2).flatten(1).numpy()
    bent = np.square((laplacian @ flat) / mass[:, None]).sum(axis=1)
    return float(np.sqrt((bent * mass)[part].sum()))


def test_the_surface_is_no_rougher_than_a_faces(
    head: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Around the lips and on the cheeks, of mixed expressions whose true motion is known."""
    vertices, faces, landmarks = head
    basis = load_face_model().expression_basis[:, : len(vertices)]
    weights = np.random.default_rng(0).random((8, len(basis))) ** 4
    true = torch.from_numpy(np.tensordot(weights, basis, axes=1))
    stm = Stm.from_pretrained(SHIPPED / "stm").eval()
    operators = surface_operators(
        vertices / stm.options.length_scale, faces, k=stm.options.k_eig, cache=False
    ).to(dtype=torch.float32)
    with torch.no_grad():
        features = stm.encode(torch.from_numpy(vertices).float(), operators)
    told = true[:, landmarks.tolist()].float()

    def output(**options: float) -> torch.Tensor:
        follower = follower_of(vertices, faces, **options)
        return stm.frame_decoder(features, operators, follower=follower).decode(told)

    rough, smooth = output(detail=0.0, finest=0.0), output()
    distance = np.linalg.norm(vertices[:, None] - vertices[landmarks][None], axis=-1)
    front = vertices[:, 2] > vertices[landmarks[[0, 16]], 2].min()
    lips = distance[:, 48:60].min(axis=1) < 0.012
    cheeks = front & (distance.min(axis=1) > 0.012) & (distance.min(axis=1) < 0.045)
    for part, without in ((lips, 2.0), (cheeks, 1.2)):
        wanted = roughness(true, vertices, faces, part)
        assert roughness(rough, vertices, faces, part) > without * wanted
        assert roughness(smooth, vertices, faces, part) < 1.15 * wanted
    assert (smooth - true).norm(dim=-1).mean() <= 1.01 * (rough - true).norm(dim=-1).mean()


def test_it_is_differentiable(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], follower: LandmarkFollower, told: torch.Tensor
) -> None:
    """A network is trained through it: what is told replaces what the network has there."""
    given = torch.zeros(FRAMES, len(head[0]), 3, requires_grad=True)
    follower.apply(given, told).square().sum().backward()
    assert given.grad is not None and given.grad.abs().max() > 0


def test_other_shapes_are_refused(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], follower: LandmarkFollower, told: torch.Tensor
) -> None:
    with pytest.raises(ValueError, match="displacements"):
        follower.apply(torch.zeros(FRAMES, 7, 3), told)
    with pytest.raises(ValueError, match="landmarks"):
        follower.apply(torch.zeros(2, len(head[0]), 3), told)
    with pytest.raises(ValueError, match="noise"):
        follower_of(*head[:2], noise=0.0)
    with pytest.raises(ValueError, match="far must be above near"):
        follower_of(*head[:2], near=0.2)


@pytest.mark.parametrize("off", [-0.0012, 0.0012])
def test_guessed_landmarks_move_the_lip_they_belong_to(off: float) -> None:
    vertices, faces, marks = sewn_head()
    slit = cut_lips(freetalk.Mesh(vertices, faces.tolist()), marks)
    points, triangles = np.asarray(slit.mesh.vertices), np.asarray(slit.mesh.faces)
    guessed = marks.copy()
    guessed[60:68, 1] += off
    follower = LandmarkFollower(
        points,
        triangles,
        landmarks=guessed,
        normals=vertex_normals(vertices, faces)[cKDTree(vertices).query(marks)[1]],
    )
    told = torch.zeros(1, 68, 3)
    told[0, [5, 6, 7, 8, 9, 10, 11, *range(55, 60), 65, 66, 67], 1] = -0.01  # jaw and lower lip
    moved = follower.apply(torch.zeros(1, len(points), 3), told)[0, :, 1].numpy()
    upper, lower = cKDTree(points).query_pairs(4e-5, output_type="ndarray").T
    swap = points[upper, 1] < points[lower, 1]
    upper, lower = np.where(swap, lower, upper), np.where(swap, upper, lower)
    middle = np.abs(points[upper, 0] - marks[62, 0]) < 0.012
    assert middle.sum() > 20
    assert np.abs(moved[upper[middle]]).max() < 0.003
    assert moved[lower[middle]].max() < -0.006


@pytest.mark.parametrize(
    ("wider", "higher"), [(2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.5), (-1.5, 1.5)]
)
def test_guessed_lids_are_put_on_the_rims_of_the_eyes(
    head: tuple[np.ndarray, np.ndarray, np.ndarray], wider: float, higher: float
) -> None:
    _, faces, marks = head
    model = load_face_model()
    basis = model.identity_basis[:, marks].astype(np.float64)
    mouth = basis[:, 54, 0] - basis[:, 48, 0]  # the eyes of a wider mouth lie farther apart
    eyes = basis[:, [37, 38, 43, 44], 1].sum(axis=1) - basis[:, [41, 40, 47, 46], 1].sum(axis=1)
    weights = wider * mouth / np.linalg.norm(mouth) + higher * eyes / np.linalg.norm(eyes)
    moved = np.tensordot(weights, model.identity_basis[:, : EXTENTS["sockets"]], axes=1)
    vertices = model.neutral[: EXTENTS["sockets"]].astype(np.float64) + moved
    vertices += model.neutral[marks].mean(axis=0) - vertices[marks].mean(axis=0)

    def missed(**options: float) -> np.ndarray:
        follower = follower_of(vertices, faces, **options)
        places = (
            vertices[follower.corners.numpy()] * follower.shares.numpy()[..., None].astype(float)
        ).sum(axis=1)
        lids = [37, 38, 40, 41, 43, 44, 46, 47]
        return np.asarray(np.linalg.norm(places[lids] - vertices[marks[lids]], axis=1))

    assert missed(guessed=True).max() < 1.3e-3
    assert missed(guessed=True).mean() < max(0.6 * missed().mean(), 5e-4)


def test_eyes_that_are_closed_skin_keep_their_guess() -> None:
    face = built_in_face()
    places = np.asarray(face.neutral, np.float64)[face.landmarks]
    grid = np.linspace(-0.08, 0.08, 60)
    x, y = np.meshgrid(grid, grid)
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + 60], axis=1),
            np.stack([corner + 1, corner + 61, corner + 60], axis=1),
        ]
    )
    flat = places * [1, 1, 0]
    followers = [
        LandmarkFollower(
            vertices,
            faces,
            landmarks=flat,
            normals=np.zeros((68, 3)),
            options=FollowOptions(guessed=guessed),
        )
        for guessed in (False, True)
    ]
    assert torch.equal(followers[0].weights, followers[1].weights)
