"""The shipped weights speak: properties of real output, on real English speech."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import freetalk as ft
from freetalk._pretrained import PRETRAINED
from freetalk.ats import GenerateOptions, generate, parse_emotion
from freetalk.corpus import load_face_model, mean_face, speech_clip
from freetalk.data import lip_opening
from freetalk.evaluate.speech_motion import correlation, log_energy
from freetalk.speech import encode_speech
from freetalk.talker import Talker

OPEN_SMALL = PRETRAINED / "open-small"


@pytest.fixture(scope="module")
def talker() -> Talker:
    return Talker.from_pretrained("open-small")


@pytest.fixture(scope="module")
def speech() -> ft.Audio:
    audio = ft.load_audio(speech_clip())
    return ft.Audio(np.asarray(audio.samples)[: 5 * 16000], 16000)


@pytest.fixture(scope="module")
def face() -> ft.Mesh:
    vertices, faces = mean_face("narrow")
    return ft.Mesh(vertices, faces)


@pytest.fixture(scope="module")
def animation(talker: Talker, speech: ft.Audio, face: ft.Mesh) -> ft.Animation:
    return talker.animate(speech, face, emotion="neutral", num_steps=20, seed=1, progress=False)


def test_lips_follow_the_loudness_of_the_speech(animation: ft.Animation, speech: ft.Audio) -> None:
    landmarks = load_face_model().landmarks68
    opening = lip_opening(np.asarray(animation.displacements)[:, landmarks])
    energy = log_energy(np.asarray(speech.samples), len(opening), 30.0, 16000)
    assert correlation(opening, energy) > 0.4  # 0 for lips that ignore the sound


def test_motion_has_a_human_size_and_does_not_jitter(animation: ft.Animation) -> None:
    motion = np.linalg.norm(np.asarray(animation.displacements), axis=-1)
    assert 0.003 < motion.max() < 0.04  # metres: speech moves a jaw by one or two centimetres
    velocity = np.diff(np.asarray(animation.displacements), axis=0)
    assert np.linalg.norm(velocity, axis=-1).max() < 0.015  # 45 cm/s


def test_same_seed_same_bits_other_seed_other_motion(
    talker: Talker, speech: ft.Audio, face: ft.Mesh, animation: ft.Animation
) -> None:
    def again(seed: int) -> np.ndarray:
        result = talker.animate(
            speech, face, emotion="neutral", num_steps=20, seed=seed, progress=False
        )
        return np.asarray(result.displacements)

    assert np.array_equal(again(1), np.asarray(animation.displacements))
    assert not np.allclose(again(2), np.asarray(animation.displacements), atol=1e-5)


def test_mesh_stage_reproduces_a_smile_on_an_unseen_meshing() -> None:
    """Ground-truth landmarks of one expression, on the 9,409-vertex face that training never saw."""
    from freetalk.geometry import surface_operators
    from freetalk.stm import Stm

    stm = Stm.from_pretrained(OPEN_SMALL / "stm")
    model = load_face_model()
    vertices, faces = mean_face("face")
    operators = surface_operators(vertices / stm.options.length_scale, faces, k=stm.options.k_eig)
    weights = np.zeros(len(model.expression_names), dtype=np.float32)
    for name, weight in (("mouthSmile_L", 0.6), ("mouthSmile_R", 0.6), ("jawOpen", 0.3)):
        weights[model.index(name)] = weight
    true = np.tensordot(weights, model.expression_basis, axes=1)
    with torch.no_grad():
        guess = stm(
            torch.from_numpy(vertices.astype(np.float32)),
            operators.to(torch.float32),
            torch.from_numpy(true[model.landmarks68][None].astype(np.float32)),
        )[0].numpy()
    error = np.linalg.norm(guess - true[: len(vertices)], axis=-1).mean()
    still = np.linalg.norm(true[: len(vertices)], axis=-1).mean()
    assert error < 0.35 * still


def test_stronger_emotion_moves_the_upper_face_more(talker: Talker) -> None:
    from freetalk.ats import Ats
    from freetalk.speech import SpeechEncoder

    folder = OPEN_SMALL
    ats = Ats.from_pretrained(folder / "ats")
    encoder = SpeechEncoder.from_pretrained(folder / "speech")
    samples = torch.from_numpy(np.asarray(ft.load_audio(speech_clip()).samples)[: 3 * 16000].copy())
    with torch.no_grad():
        features = encode_speech(encoder, samples, ats.options.fps)
    amounts = {}
    for level in (1.0, 3.0):
        motion = generate(
            ats,
            features,
            emotion=parse_emotion("surprise", ats.options.emotions),
            intensity=level,
            options=GenerateOptions(num_steps=20),
        )
        amounts[level] = float(motion[:, 17:48].norm(dim=-1).mean())
    assert amounts[3.0] > 1.2 * amounts[1.0]
    assert talker.emotions == list(ats.options.emotions)


def test_facetalks_lips_follow_the_loudness_and_do_not_jitter(
    talker: Talker, speech: ft.Audio, face: ft.Mesh
) -> None:
    spoken = talker.animate(speech, face, motion="facetalk", seed=1, progress=False)
    motion = np.asarray(spoken.displacements)
    opening = lip_opening(motion[:, load_face_model().landmarks68])
    energy = log_energy(np.asarray(speech.samples), len(opening), 30.0, 16000)
    assert correlation(opening, energy) > 0.4  # 0 for lips that ignore the sound
    assert 0.003 < np.linalg.norm(motion, axis=-1).max() < 0.04  # metres, as above
    assert np.linalg.norm(np.diff(motion, axis=0), axis=-1).max() < 0.015


def test_facetalk_moves_the_parametric_head(talker: Talker, speech: ft.Audio) -> None:
    head = talker.prepare_head(talker.sample_identity(7), progress=False)
    second = ft.Audio(np.asarray(speech.samples)[:16000], 16000)
    spoken = head.animate(second, motion="facetalk", seed=1, progress=False)
    motion = np.linalg.norm(np.asarray(spoken.displacements), axis=-1)
    assert motion.shape[0] == 30 and 0.002 < motion.max() < 0.05
    away = np.asarray(head.mesh.vertices)[:, 2] < np.quantile(
        np.asarray(head.mesh.vertices)[:, 2], 0.2
    )
    assert motion[:, away].max() < 0.3 * motion.max()  # the back of the head hardly moves
