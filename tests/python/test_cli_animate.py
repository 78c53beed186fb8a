"""Commands that do the work, on a small face with small random weights."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_talker import write_weights

import freetalk as ft
from freetalk import _pretrained
from freetalk.cli import main
from freetalk.corpus import assets


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Half a second of speech, half a second of silence, a face in centimetres, weights."""
    folder = tmp_path_factory.mktemp("cli")
    samples = np.asarray(ft.load_audio(assets.speech_clip()).samples)[8000:16000]
    ft.audio.save_wav(folder / "speech.wav", ft.Audio(samples, 16000))
    ft.audio.save_wav(folder / "silence.wav", ft.Audio(np.zeros(8000, np.float32), 16000))
    vertices, faces = assets.mean_face("narrow")
    face = ft.Mesh(100 * vertices.astype(np.float64), faces.tolist(), name="face")
    ft.mesh.save_mesh(folder / "face.obj", face)
    (folder / "weights").mkdir()
    write_weights(folder / "weights")
    return folder


@pytest.fixture(autouse=True)
def cache(room: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FREETALK_CACHE", str(room / "cache"))


def animate(room: Path, *more: str | Path, audio: str = "speech.wav") -> int:
    arguments = ["animate", "--audio", room / audio, "--mesh", room / "face.obj"]
    arguments += ["--pretrained", room / "weights", *more]
    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def talk(room: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An animation, made by the command line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FREETALK_CACHE", str(room / "cache"))
        path = tmp_path_factory.mktemp("made") / "talk.npz"
        assert animate(room, "--quiet", "--seed", "3", "--out", path) == 0
    return path


@pytest.mark.slow
def test_every_output_is_written_at_once(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("deep/talk.npz", "talk.glb", "talk.html", "talk.mp4", "frames/*.ply", "meshes/")
    outputs = [word for name in names for word in ("--out", f"{tmp_path}/{name}")]
    assert animate(room, *outputs, "--size", "64", "--fps", "10", "--emotion", "happy") == 0
    printed = capsys.readouterr().out
    assert "guessed unit cm" in printed
    for name in ("talk.npz", "talk.glb", "talk.html", "talk.mp4", "frames/", "meshes/"):
        assert name in printed
    expected = {"deep", "talk.glb", "talk.speech.wav", "talk.html", "talk.mp4", "frames", "meshes"}
    assert {entry.name for entry in tmp_path.iterdir()} == expected
    assert len(list((tmp_path / "frames").glob("*.ply"))) == 5
    assert len(list((tmp_path / "meshes").glob("*.obj"))) == 5
    with np.load(tmp_path / "deep" / "talk.npz") as arrays:
        assert arrays["displacements"].shape == (5, 6706, 3)
        assert np.abs(arrays["displacements"]).max() > 0
        np.testing.assert_array_equal(arrays["faces"], assets.mean_face("narrow")[1])


def test_one_output_that_fails_loses_none_of_the_others(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save = ft.Animation.save

    def full_disk(animation: ft.Animation, path: Path, **options: object) -> object:
        if Path(path).suffix == ".glb":
            raise RuntimeError(f"{path}: no space left on device")
        return save(animation, path, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(ft.Animation, "save", full_disk)
    outputs = ["--out", tmp_path / "a.glb", "--out", tmp_path / "b.npz"]
    assert animate(room, "--quiet", "--fps", "10", *outputs) == 2
    printed = capsys.readouterr().err
    assert "a.glb: no space left" in printed
    assert (tmp_path / "b.npz").is_file()
    kept = room / "cache" / "unsaved.npz"
    assert str(kept) in printed
    assert kept.read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_same_seed_same_bytes(room: Path, talk: Path, tmp_path: Path) -> None:
    for seed in ("3", "4"):
        assert animate(room, "--quiet", "--seed", seed, "--out", tmp_path / f"{seed}.npz") == 0
    assert (tmp_path / "3.npz").read_bytes() == talk.read_bytes()
    assert (tmp_path / "4.npz").read_bytes() != talk.read_bytes()


def test_quiet_prints_nothing(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(room, "--quiet", "--steps", "2", "--out", tmp_path / "talk.npz") == 0
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_silence_is_animated_and_said(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(room, "--out", tmp_path / "talk.npz", audio="silence.wav") == 0
    assert "silent" in capsys.readouterr().out
    assert (tmp_path / "talk.npz").is_file()


def test_without_mesh_the_built_in_face_speaks(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "talk.npz"
    arguments = ["--audio", room / "speech.wav", "--pretrained", room / "weights", "--out", out]
    assert main(["animate", *map(str, arguments)]) == 0
    assert "built-in" in capsys.readouterr().out
    assert ft.Animation.load(out).vertices.shape == (9409, 3)


@pytest.mark.slow
def test_folders_of_recordings_and_meshes_are_animated(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sounds, meshes = tmp_path / "sounds", tmp_path / "meshes"
    for folder, files in ((sounds, ("speech.wav", "silence.wav")), (meshes, ("face.obj",))):
        folder.mkdir()
        for file in files:
            shutil.copyfile(room / file, folder / file)
    (sounds / "broken.wav").write_text("no sound")
    out = tmp_path / "out"
    given = ["animate", "--audio", sounds, "--mesh", meshes, "--pretrained", room / "weights"]
    given += ["--steps", "2", "--fps", "10", "--device", "cpu"]
    assert main([str(word) for word in (*given, "--out", out / "{name}.npz")]) == 2
    captured = capsys.readouterr()
    assert "1 of 3 animations failed: broken.wav on face.obj" in captured.err
    assert {file.name for file in out.iterdir()} == {"speech_face.npz", "silence_face.npz"}
    alone = tmp_path / "alone.npz"
    assert animate(room, "--quiet", "--steps", "2", "--fps", "10", "--out", alone) == 0
    assert alone.read_bytes() == (out / "speech_face.npz").read_bytes()


def test_an_intensity_beyond_the_weights_is_refused(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(room, "--intensity", "3.01", "--out", tmp_path / "talk.glb") == 2
    assert "these weights know 1 (slight) to 3 (strong)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_unknown_emotion_lists_the_known_ones(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(room, "--emotion", "hungry", "--out", tmp_path / "talk.glb") == 2
    captured = capsys.readouterr()
    assert len(captured.err.strip().splitlines()) == 1
    assert "hungry" in captured.err and "happy" in captured.err and "contempt" in captured.err
    assert not captured.out  # said before the mesh is prepared
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_sampling_options_and_keyframes_reach_the_talker(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "talk.npz"
    emotion = "0=neutral; 0.3=happy:0.7,surprise:0.3@2.5"
    options = [
        "--emotion",
        emotion,
        "--sampler",
        "dpmpp",
        "--steps",
        "6",
        "--precision",
        "bfloat16",
    ]
    options += ["--guidance", "audio=1.5,emotion=2", "--mouth-temperature", "0.25", "--no-blinks"]
    options += ["--tolerance-mm", "0", "--articulation", "1.25", "--head-motion"]
    assert animate(room, *options, "--out", out) == 0
    saved = ft.Animation.load(out)
    used = saved.metadata["options"]
    assert saved.head is not None and saved.head.shape == (saved.num_frames, 4, 4)
    assert used["emotion"] == emotion
    wanted = {"sampler": "dpmpp", "num_steps": 6, "precision": "bfloat16"}
    wanted |= {
        "audio_guidance": 1.5,
        "affect_guidance": 2.0,
        "mouth_temperature": 0.25,
        "articulation": 1.25,
        "head_motion": True,
        "tolerance_mm": 0.0,
    }
    assert {name: used[name] for name in wanted} == wanted
    assert not used["blinks"]
    assert animate(room, "--guidance", "1.5", "--steps", "2", "--out", out) == 0
    used = ft.Animation.load(out).metadata["options"]
    assert (used["audio_guidance"], used["affect_guidance"], used["blinks"]) == (1.5, 1.5, True)


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--guidance", "loud=2", "audio=1.5,emotion=2"),
        ("--guidance", "audio=1,audio=2", "audio=1.5,emotion=2"),
        ("--guidance", "-1", "0 to 100"),
        ("--mouth-temperature", "2", "0 to 1"),
        ("--tolerance-mm", "-1", "0 for none"),
        ("--articulation", "2", "0.5 to 1.5"),
        ("--sampler", "euler", "dpmpp"),
        ("--emotion", "0=neutral; happy", "has no time"),
        ("--emotion", "1=happy; 0=sad", "must rise"),
        ("--emotion", "0=happy; 1=sad@5", "between 1 and 3"),
    ],
)
def test_wrong_sampling_options_are_refused(
    room: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
    value: str,
    said: str,
) -> None:
    assert animate(room, f"{option}={value}", "--out", tmp_path / "talk.glb") == 2
    error = capsys.readouterr().err
    assert len(error.strip().splitlines()) == 1 and said in error
    assert not list(tmp_path.iterdir())


def test_wrong_pose_options_are_refused(
    room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert animate(room, "--up", "+y", "--forward", "-y", "--out", tmp_path / "talk.glb") == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_view_renders_to_files(
    talk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    png, mp4 = tmp_path / "a.png", tmp_path / "a.mp4"
    arguments = ["view", talk, "--png", png, "--mp4", mp4, "--size", "64", "--time", "0.2"]
    assert main([str(argument) for argument in arguments]) == 0
    assert png.read_bytes().startswith(b"\x89PNG") and mp4.stat().st_size > 1000
    assert str(png) in capsys.readouterr().out


def test_mesh_check_reports_counts_and_pose(room: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, folder = str(room / "face.obj"), str(room / "weights")
    assert main(["mesh", "check", file, "--pretrained", folder]) == 0
    printed = capsys.readouterr().out
    assert "6706 vertices" in printed and "guessed unit cm" in printed and "parts: 1" in printed


def test_speech_encode_writes_one_row_a_frame(room: Path, tmp_path: Path) -> None:
    out = tmp_path / "features.npy"
    arguments = ["--audio", room / "speech.wav", "--pretrained", room / "weights", "--out", out]
    assert main(["speech", "encode", *map(str, arguments), "--fps", "25"]) == 0
    assert np.load(out).shape == (13, 32)  # round(0.5 s * 25), hidden size
    assert [entry.name for entry in tmp_path.iterdir()] == ["features.npy"]


def test_models_are_listed(
    room: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(_pretrained, "PRETRAINED", room)
    for words in (["models"], ["models", "list"]):
        assert main(words) == 0
        printed = capsys.readouterr().out
        assert "weights: " in printed and "contempt" in printed and "30 fps" in printed


def test_train_passes_everything_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from freetalk import train

    seen: list[object] = []

    def run(*arguments: object) -> SimpleNamespace:
        seen.extend(arguments)
        scores = {"loss": 0.25}
        return SimpleNamespace(
            status="finished", step=7, scores=scores, directory=tmp_path, lacking=""
        )

    monkeypatch.setattr(train, "run", run)
    config, out = tmp_path / "c.yaml", tmp_path / "out"
    config.write_text("model: {}\n")
    arguments = ["--config", config, "--data", tmp_path, "--out", out, "loop.max_steps=7"]
    assert main(["train", "stm", *map(str, arguments)]) == 0
    assert seen == ["stm", str(config), ["loop.max_steps=7"], [str(tmp_path)], str(out)]
    assert "finished at step 7: loss 0.25" in capsys.readouterr().out


def test_evaluate_passes_everything_on(
    room: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from freetalk import data
    from freetalk.evaluate import weights as scores_of

    seen: dict[str, object] = {}

    def measure(dataset: object, weights: Path, **options: object) -> dict[str, float]:
        seen.update(dataset=dataset, weights=weights, **options)
        return {"opening": 0.5}

    monkeypatch.setattr(data, "open_datasets", str)
    monkeypatch.setattr(scores_of, "measure", measure)
    options = ["--data", str(tmp_path), "--pretrained", str(room / "weights"), "--parts", "ats"]
    scores = tmp_path / "scores.json"
    assert main(["evaluate", *options, "--out", str(scores)]) == 0
    assert seen["dataset"] == str(tmp_path) and seen["weights"] == room / "weights"
    assert seen["parts"] == ["ats"] and seen["device"] is None
    assert seen["steps"] is None  # those of the weights
    assert json.loads(scores.read_text()) == {"opening": 0.5}
