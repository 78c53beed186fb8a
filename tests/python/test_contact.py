"""Lips and lids that touch in the mean face's motion touch on other faces, and do not pass through."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from freetalk.corpus.assets import EXTENTS, crop_quads, load_face_model, triangulate
from freetalk.geometry import surface_operators
from freetalk.stm import LandmarkCarrier, LandmarkFollower, Stm

LIPS, LIDS = ((61, 67), (62, 66), (63, 65)), ((37, 41), (38, 40), (43, 47), (44, 46))


def mean_landmarks() -> np.ndarray:
    model = load_face_model()
    return model.neutral[model.landmarks68].astype(np.float64)


def head_of(weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and landmarks of an identity of the built-in face with sockets."""
    model, count = load_face_model(), EXTENTS["sockets"]
    vertices = model.neutral[:count].astype(np.float64)
    vertices += np.tensordot(weights, model.identity_basis[:, :count].astype(np.float64), axes=1)
    return vertices, triangulate(crop_quads(model, "sockets")), vertices[model.landmarks68]


def carrier_of(weights: np.ndarray, known: bool = True) -> tuple[LandmarkCarrier, np.ndarray]:
    """Of such a head, and its landmarks (68, 3)."""
    vertices, faces, marks = head_of(weights)
    follower = LandmarkFollower(vertices, faces, landmarks=marks, normals=np.zeros((68, 3)))
    mean = mean_landmarks()
    return LandmarkCarrier(vertices, faces, follower=follower, mean=mean, known=known), marks


def closed(mean: np.ndarray, share: float) -> torch.Tensor:
    """(1, 68, 3) upper lids of the mean face that go a share of the way to the lower ones."""
    motion = torch.zeros(1, 68, 3)
    for upper, lower in LIDS:
        motion[0, upper] = torch.from_numpy(share * (mean[lower] - mean[upper]))
    return motion


def eyes(deviations: float) -> np.ndarray:
    """Weights of an identity with larger or smaller eyes."""
    model = load_face_model()
    height = model.identity_basis[:, model.landmarks68, 1].astype(np.float64)
    opening = sum(height[:, a] - height[:, b] for a, b in LIDS)
    return deviations * np.asarray(opening) / np.linalg.norm(opening)


def lips_open(opening_m: float) -> torch.Tensor:
    """(1, 68, 3) a lower lip that goes down."""
    motion = torch.zeros(1, 68, 3)
    motion[0, [55, 56, 57, 58, 59, 65, 66, 67], 1] = -opening_m
    return motion


def gaps(motion: torch.Tensor, pairs: tuple[tuple[int, int], ...]) -> np.ndarray:
    """(T, pairs) m, what the motion adds to the openings of pairs."""
    height = motion[..., 1].numpy().astype(np.float64)
    return np.stack([height[:, a] - height[:, b] for a, b in pairs], axis=1)


def test_lips_close_by_their_clearance_and_no_further() -> None:
    carrier, _ = carrier_of(1.2 * np.random.default_rng(0).standard_normal(100))
    clearance = np.asarray(carrier.lip_clearance)
    assert (clearance > 2e-4).all()
    for opening in (0.0002, 0.0, -0.002):
        made = gaps(carrier.apply(lips_open(opening)), LIPS)[0]
        np.testing.assert_array_less(made, -clearance + 1e-6)
        np.testing.assert_array_less(-clearance - 1.6e-4, made)


def test_wide_openings_stay_and_the_order_of_openings_is_kept() -> None:
    carrier, _ = carrier_of(np.zeros(100))
    np.testing.assert_allclose(gaps(carrier.apply(lips_open(0.012)), LIPS), 0.012, atol=1e-6)
    wanted = torch.cat([lips_open(x) for x in np.linspace(-0.002, 0.012, 57)])
    assert (np.diff(gaps(carrier.apply(wanted), LIPS), axis=0) > -1e-7).all()


@pytest.mark.parametrize("deviations", [-3.0, 0.0, 3.0])
def test_lids_go_as_far_as_the_eye_is_open(deviations: float) -> None:
    carrier, marks = carrier_of(eyes(deviations))
    clearance = np.asarray(carrier.lid_clearance)
    of_landmarks = np.array([marks[a, 1] - marks[b, 1] for a, b in LIDS])
    np.testing.assert_allclose(clearance, of_landmarks, rtol=0.08)
    blink = closed(mean_landmarks(), 0.96)
    moved = carrier.apply(blink)[0].numpy()
    for (upper, lower), width in zip(LIDS, clearance):
        line = (marks[upper] - marks[lower]) / np.linalg.norm(marks[upper] - marks[lower])
        np.testing.assert_allclose(moved[upper] - moved[lower], -1.02 * width * line, atol=1e-5)
    half = carrier.apply(0.5 * blink)[0].numpy()
    lengths = [np.linalg.norm(half[a] - half[b]) for a, b in LIDS]
    np.testing.assert_allclose(lengths, 0.48 * clearance, rtol=0.01)


@pytest.mark.parametrize("deviations", [0.0, 3.0])
def test_lids_meet_on_the_decoded_surface(
    deviations: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "scripts" / "bench"))
    import contact

    vertices, faces, marks = head_of(eyes(deviations))
    follower = LandmarkFollower(vertices, faces, landmarks=marks, normals=np.zeros((68, 3)))
    model = Stm.from_pretrained(contact.SHIPPED / "stm").eval()
    options = model.options
    operators = surface_operators(vertices / options.length_scale, faces, k=options.k_eig)
    operators = operators.to(dtype=torch.float32)
    features = model.encode(torch.from_numpy(vertices).float(), operators)
    decoder = model.frame_decoder(features, operators, follower=follower)
    mean = mean_landmarks()
    blink = closed(mean, 0.96)
    sides = contact.gaps_of((vertices, faces, marks), LIDS)
    assert len(sides) == 6  # two pairs of each eye, and between them
    worst = []
    for own in (None, decoder):
        carrier = LandmarkCarrier(
            vertices, faces, follower=follower, mean=mean, known=True, decoder=own
        )
        moved = decoder.decode(carrier.apply(blink))[0].numpy()
        worst.append(np.max([contact.touch(vertices + moved, each) for each in sides], axis=0))
    assert worst[0][0] > 0.45  # mm: where landmarks meet, the arches between them do not
    assert worst[1][0] <= 0.3
    assert worst[1][1] <= 0.5


def test_guessed_landmarks_do_not_scale_the_mouth() -> None:
    model = load_face_model()
    lateral = model.identity_basis[:, model.landmarks68, 0].astype(np.float64)
    wide = lateral[:, 54] - lateral[:, 48]
    weights = 3 * wide / np.linalg.norm(wide)
    smile = torch.zeros(1, 68, 3)
    smile[0, 54, 0], smile[0, 48, 0] = 0.004, -0.004
    known, guessed = (carrier_of(weights, each)[0].apply(smile)[0, 54, 0] for each in (True, False))
    assert float(known) == pytest.approx(0.0049, rel=0.05)
    assert float(guessed) == pytest.approx(0.004, rel=1e-6)


def test_frames_are_independent() -> None:
    carrier, _ = carrier_of(eyes(2.0))
    motion = 0.004 * torch.randn(9, 68, 3, generator=torch.Generator().manual_seed(0))
    each = torch.cat([carrier.apply(frame[None]) for frame in motion])
    assert torch.equal(carrier.apply(motion), each)


def test_shapes_are_checked() -> None:
    carrier, _ = carrier_of(np.zeros(100))
    with pytest.raises(ValueError, match=r"expected landmarks \(T, 68, 3\)"):
        carrier.apply(torch.zeros(68, 3))
