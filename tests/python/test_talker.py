"""The whole pipeline, on a real face and real speech, with small random weights."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

import freetalk
from freetalk import _native
from freetalk.ats import Ats
from freetalk.corpus import assets
from freetalk.speech import SpeechEncoder, SpeechEncoderOptions
from freetalk.stm import Stm


def write_weights(folder: Path) -> Path:
    """A talker of a few thousand random parameters."""
    torch.manual_seed(3)
    speech = SpeechEncoder(
        SpeechEncoderOptions(
            hidden_size=32,
            num_hidden_layers=1,
            num_attention_heads=2,
            intermediate_size=32,
            conv_dim=[16] * 7,
            num_conv_pos_embeddings=8,
            num_conv_pos_embedding_groups=4,
        )
    )
    speech.save_pretrained(folder / "speech")
    ats = Ats(d_model=32, num_layers=1, num_heads=2, ff_dim=32, audio_dim=32, max_frames=60)
    ats.set_motion_statistics(torch.zeros(204), torch.full((204,), 2e-3))
    ats.save_pretrained(folder / "ats")
    small = dict.fromkeys(
        ("encoder_width", "decoder_width", "feature_dim", "gcn_hidden", "index_code_dim"), 16
    )
    stm = Stm(**small, encoder_blocks=1, decoder_blocks=1, attention_dim=16, k_eig=16)
    with torch.no_grad():
        for name, parameter in stm.named_parameters():
            if name.startswith("decoder.last_lin"):  # starts at zero: nothing would move
                parameter.normal_(0, 0.1)
    stm.save_pretrained(folder / "stm")
    model = assets.load_face_model()
    vertices, faces = assets.mean_face("face")
    normals = _native.mesh.vertex_normals(vertices.astype(np.float64), faces)
    template = {
        "points": torch.from_numpy(vertices[::3].copy()),
        "normals": torch.from_numpy(normals[::3].astype(np.float32)),
        "landmarks68": torch.from_numpy(model.neutral[model.landmarks68].copy()),
    }
    _native.core.save_safetensors(folder / "template.safetensors", template)
    description = {"format": "freetalk-talker", "version": 1, "generate": {"num_steps": 4}}
    (folder / "talker.json").write_text(json.dumps(description))
    return folder


POSE = {"unit": "cm", "up": "+z", "forward": "-y"}
"""Of the face below: nothing left to guess."""


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_weights(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="module")
def talker(weights: Path) -> freetalk.Talker:
    return freetalk.Talker.from_pretrained(weights, device="cpu")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def speech() -> freetalk.Audio:
    clip = freetalk.load_audio(assets.speech_clip())
    return freetalk.Audio(np.array(clip.samples[:12800]), 16000)


@pytest.fixture(scope="module")
def face() -> freetalk.Mesh:
    """The mean narrow face in centimetres, lying on its back: +Z up, -Y forward."""
    vertices, faces = assets.mean_face("narrow")
    turned = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    return freetalk.Mesh(turned * 100, faces, name="narrow")


def test_animates_in_the_meshs_own_unit_and_axes(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str, tmp_path: Path
) -> None:
    animation = talker.animate(speech, face, emotion="happy", cache_dir=cache, progress=False)
    assert animation.displacements.shape == (24, 6706, 3)
    assert torch.isfinite(animation.displacements).all()
    alignment = animation.metadata["alignment"]
    assert (alignment["unit"], alignment["up"], alignment["forward"]) == ("cm", "+z", "-y")
    assert animation.frame.metres_per_unit == 0.01
    upright = np.asarray(animation.frame.to_y_up) @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(upright, [0, 1, 0], atol=1e-12)
    np.testing.assert_array_equal(animation.faces, face.faces)
    assert talker.report is not None
    prepared = {"align", "parts", "operators", "features"}
    assert set(talker.report.timings) == prepared | {"speech", "motion", "surface"}
    assert talker.report.num_frames == 24
    assert animation.metadata["decoding"]["decoded_frames"] == talker.report.decoded_frames
    for name in ("talk.npz", "talk.glb"):
        animation.save(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 0


def test_same_seed_same_file(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str, tmp_path: Path
) -> None:
    for name, seed in (("a", 5), ("b", 5), ("c", 6)):
        animation = talker.animate(
            speech, face, seed=seed, fps=10, **POSE, cache_dir=cache, progress=False
        )
        animation.save(tmp_path / f"{name}.npz")
    first, again, other = ((tmp_path / f"{name}.npz").read_bytes() for name in "abc")
    assert first == again
    assert first != other


def test_paths_and_progress(
    talker: freetalk.Talker, face: freetalk.Mesh, cache: str, tmp_path: Path
) -> None:
    from freetalk.audio import save_wav
    from freetalk.mesh import save_mesh

    save_wav(tmp_path / "a.wav", freetalk.Audio(np.full(7680, 0.1, np.float32), 16000))
    save_mesh(tmp_path / "a.obj", face)
    seen: list[float] = []
    animation = talker.animate(
        tmp_path / "a.wav",
        tmp_path / "a.obj",
        fps=25,
        cache_dir=cache,
        progress=lambda done, total: seen.append(done / total),
    )
    assert animation.num_frames == 12
    assert seen == sorted(seen)
    assert seen[-1] == pytest.approx(1.0)


def test_a_callback_may_stop_the_work(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str
) -> None:
    def stop(done: float, total: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        talker.animate(speech, face, cache_dir=cache, progress=stop)


def test_silence_rests(talker: freetalk.Talker, face: freetalk.Mesh, cache: str) -> None:
    silence = freetalk.Audio(np.zeros(16000 * 5, np.float32), 16000)
    animation = talker.animate(silence, face, fps=10, **POSE, cache_dir=cache, progress=False)
    assert animation.num_frames == 50
    assert "silent" in animation.metadata["notices"][0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"emotion": "hungry"}, "surprise"),
        ({"intensity": 4}, "intensity"),
        ({"fps": 0}, "fps"),
        ({"fps": 1000}, "fps"),
        ({"unit": "mile"}, "mile"),
        ({"emotional": "happy"}, "emotion"),
    ],
)
def test_bad_options_say_what_is_known(
    talker: freetalk.Talker,
    speech: freetalk.Audio,
    face: freetalk.Mesh,
    options: dict[str, object],
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message):
        talker.animate(speech, face, progress=False, **options)


def test_aliases_and_mixtures(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str
) -> None:
    def motion(emotion: str) -> torch.Tensor:
        options = {"emotion": emotion, "fps": 10, "cache_dir": cache, "progress": False} | POSE
        return talker.animate(speech, face, **options).displacements

    assert torch.equal(motion("anger"), motion("angry"))
    assert not torch.equal(motion("happy:0.7,sad:0.3"), motion("happy"))
    assert "contempt" in talker.emotions


def test_unknown_weights_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no weights 'nothing'"):
        freetalk.Talker.from_pretrained("nothing")
    with pytest.raises(ValueError, match=r"talker\.json"):
        freetalk.Talker.from_pretrained(tmp_path)


def test_several_performances_at_once(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str
) -> None:
    options: dict[str, object] = {"fps": 10, "cache_dir": cache, "progress": False, **POSE}
    options["tolerance_mm"] = 0  # which frames are decoded may turn on a rounding
    emotion = [(0.0, "neutral", 1), (0.6, {"happy": 0.7, "surprise": 0.3}, 2.5)]
    both = talker.animate_many(speech, face, seeds=[5, 6], emotion=emotion, **options)
    alone = talker.animate(speech, face, seed=6, emotion=emotion, **options)
    assert len(both) == 2
    assert both[1].metadata["options"]["seed"] == 6
    torch.testing.assert_close(both[1].displacements, alone.displacements, rtol=1e-3, atol=1e-5)
    assert not torch.allclose(both[0].displacements, alone.displacements, rtol=1e-3, atol=1e-5)
    with pytest.raises(ValueError, match="seed"):
        talker.animate_many(speech, face, seeds=[], **options)


def test_a_prepared_face_gives_what_one_call_gives(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str
) -> None:
    prepared = talker.prepare(face, **POSE, cache_dir=cache, progress=False)
    whole = talker.animate(speech, face, seed=4, **POSE, cache_dir=cache, progress=False)
    out = torch.full((prepared.num_frames(speech), len(face.vertices), 3), torch.nan)
    animation, report = prepared.animate_with_report(speech, seed=4, out=out, progress=False)
    assert animation.displacements.data_ptr() == out.data_ptr()
    assert torch.equal(out, whole.displacements)
    assert animation.metadata == whole.metadata
    assert set(report.timings) == {"speech", "motion", "surface"}
    both = prepared.animate_many(speech, seeds=[4, 5], tolerance_mm=0, progress=False)
    exact = prepared.animate(speech, seed=4, tolerance_mm=0, progress=False)
    torch.testing.assert_close(both[0].displacements, exact.displacements, rtol=1e-3, atol=1e-5)
    with pytest.raises(ValueError, match="out must be"):
        prepared.animate(speech, out=out[1:], progress=False)


def test_what_is_none_is_as_the_weights_say(
    talker: freetalk.Talker, speech: freetalk.Audio, face: freetalk.Mesh, cache: str
) -> None:
    prepared = talker.prepare(face, **POSE, cache_dir=cache, progress=False)
    own = prepared.animate(speech, progress=False)
    told = prepared.animate(
        speech, num_steps=None, sampler=None, eta=None, intensity=None, progress=False
    )
    assert torch.equal(own.displacements, told.displacements)
    assert own.metadata["options"]["num_steps"] is None
    four = prepared.animate(speech, num_steps=4, eta=0.0, intensity=2.0, progress=False)
    assert torch.equal(own.displacements, four.displacements)
    with pytest.raises(ValueError, match="'num_steps' must be an integer or null"):
        prepared.animate(speech, num_steps="four", progress=False)


def test_native_warnings_reach_logging(
    talker: freetalk.Talker,
    face: freetalk.Mesh,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    (tmp_path / "file").write_text("no folder")
    with caplog.at_level("WARNING", logger="freetalk"):
        talker.prepare(face, **POSE, cache_dir=str(tmp_path / "file" / "cache"), progress=False)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "not kept" in caplog.text


def test_live_frames_do_not_depend_on_how_samples_come(
    talker: freetalk.Talker, face: freetalk.Mesh, cache: str
) -> None:
    wave = np.array(freetalk.load_audio(assets.speech_clip()).samples)[:40000]
    live = talker.prepare(face, **POSE, cache_dir=cache, progress=False).live(emotion="happy")
    whole = live.push(wave) + live.finish()
    assert [frame.index for frame in whole] == list(range(75))
    assert whole[30].time_s == 1.0
    cut = [frame for part in np.array_split(wave, 37) for frame in live.push(part)] + live.finish()
    for first, second in zip(whole, cut, strict=True):
        assert torch.equal(first.landmarks, second.landmarks)
    assert live.latency_s == pytest.approx(0.42)
    assert live.decode(whole[40]).shape == (6706, 3)
    live.set_emotion({"sad": 1.0}, 3)
    with pytest.raises(ValueError, match="surprise"):
        live.set_emotion("hungry")
    with pytest.raises(ValueError, match="one channel"):
        live.push(wave.reshape(2, -1))
