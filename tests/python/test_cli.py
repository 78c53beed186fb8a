"""The command line: what it accepts, what it writes, and one sentence for what it refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import wave
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from freetalk import _native
from freetalk.cli import main
from freetalk.cli.app import describe
from freetalk.cli.outputs import Output, check_kept, check_writable, parse_output
from freetalk.cli.parser import UNITS, make_parser

PYTHON = Path(__file__).resolve().parents[2] / "python"
FACE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def write_wav(path: Path, samples: NDArray[np.float64], rate_hz: int = 16000) -> Path:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate_hz)
        file.writeframes((samples * 32767).astype("<i2").tobytes())
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with good speech and a triangle, and weights that are never loaded."""
    time = np.arange(8000) / 16000
    write_wav(tmp_path / "speech.wav", 0.3 * np.sin(2 * np.pi * 200 * time))
    (tmp_path / "face.obj").write_text(FACE)
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / "talker.json").write_text(json.dumps({"emotions": ["neutral"]}))
    (tmp_path / "out").mkdir()
    return tmp_path


def refused(capsys: pytest.CaptureFixture[str], folder: Path | None, *arguments: str | Path) -> str:
    """Runs a command that must fail; returns its one sentence."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("freetalk: ") and "Traceback" not in lines[0]
    if folder is not None:
        assert not list((folder / "out").iterdir()), "something was left behind"
    return lines[0]


def animate_refused(capsys: pytest.CaptureFixture[str], folder: Path, **changes: str | Path) -> str:
    """Runs `animate` with good arguments but for `changes`."""
    arguments: dict[str, str | Path] = {
        "audio": folder / "speech.wav",
        "mesh": folder / "face.obj",
        "pretrained": folder / "weights",
        "out": folder / "out" / "talk.npz",
        **changes,
    }
    pairs = [item for name, value in arguments.items() for item in (f"--{name}", value)]
    return refused(capsys, folder, "animate", *pairs)


# ---- arguments -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("fps", "0", "above 0"),
        ("fps", "1000", "at most 240"),
        ("fps", "-25", "above 0"),
        ("fps", "nan", "above 0"),
        ("fps", "fast", "'fast'"),
        ("intensity", "0.5", "at least 1 (slight)"),
        ("steps", "0", "whole number above 0"),
        ("seed", "-1", "whole number from 0"),
        ("size", "31x33", "even pixels"),
        ("unit", "feet", "feet"),
        ("up", "w", "'+y'"),
    ],
)
def test_animate_refuses_values_out_of_range(
    capsys: pytest.CaptureFixture[str], folder: Path, option: str, value: str, words: str
) -> None:
    message = animate_refused(capsys, folder, **{option: value})
    assert f"--{option}" in message and words in message
    assert "freetalk animate --help" in message


def test_missing_arguments_and_unknown_commands_are_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "--audio" in refused(capsys, None, "animate")
    assert "dance" in refused(capsys, None, "dance")
    assert "--colour" in refused(capsys, None, "models", "--colour")


@pytest.mark.parametrize(
    "command",
    ["", "animate", "train ats", "corpus build", "view", "models", "models pack", "table"],
)
def test_help_explains_every_option(capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert main([*command.split(), "--help"]) == 0
    assert "--help" in capsys.readouterr().out


def test_help_names_the_emotions(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["animate", "--help"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "neutral, afraid, ashamed, angry" in printed and "contempt" in printed


def test_units_of_the_command_line_are_the_library_s() -> None:
    assert set(UNITS) == {"auto", *_native.core.UNITS}


def test_help_is_parsed_without_heavy_imports() -> None:
    code = (
        "import importlib.util, sys, types\n"
        "package = types.ModuleType('freetalk')\n"
        f"package.__path__ = [{str(PYTHON / 'freetalk')!r}]\n"
        "sys.modules['freetalk'] = package\n"
        "from freetalk.cli import main\n"
        "main(['animate', '--help'])\n"
        "heavy = {'torch', 'numpy', 'pyvista', 'vtk', 'scipy', 'matplotlib'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)\n"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_process_ends_with_code_2_and_one_line() -> None:
    command = [sys.executable, "-m", "freetalk.cli", "animate", "--fps", "0"]
    environment = {**os.environ, "PYTHONPATH": str(PYTHON)}
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert result.returncode == 2
    assert result.stdout == "" and len(result.stderr.strip().splitlines()) == 1


# ---- inputs --------------------------------------------------------------------------------------


def test_missing_audio_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    message = animate_refused(capsys, folder, audio=folder / "nobody.wav")
    assert "nobody.wav" in message and "does not exist" in message


def test_empty_audio_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "empty.wav").touch()
    message = animate_refused(capsys, folder, audio=folder / "empty.wav")
    assert "empty.wav" in message and "is empty" in message


def test_audio_without_samples_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    file = write_wav(folder / "nothing.wav", np.zeros(0))
    assert "nothing.wav" in animate_refused(capsys, folder, audio=file)


def test_file_that_is_no_audio_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "letter.wav").write_text("Dear reader, this is no sound at all.")
    assert "letter.wav" in animate_refused(capsys, folder, audio=folder / "letter.wav")


def test_audio_with_nan_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    soundfile = pytest.importorskip("soundfile")
    samples = np.zeros(1000, np.float32)
    samples[500] = np.nan
    soundfile.write(folder / "nan.wav", samples, 16000, subtype="FLOAT")
    assert "nan.wav" in animate_refused(capsys, folder, audio=folder / "nan.wav")


def test_folder_without_audio_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    (folder / "nothing").mkdir()
    out = folder / "out" / "{name}.npz"
    assert "holds no .wav" in animate_refused(capsys, folder, audio=folder / "nothing", out=out)


def test_folders_need_a_place_for_each_animation(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    message = animate_refused(capsys, folder, audio=folder)
    assert "talk.npz' is one place for many" in message
    message = animate_refused(capsys, folder, out=folder / "out" / "{name}.npz")
    assert "none was given" in message


def test_files_that_differ_in_suffix_alone_are_refused(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    sounds = folder / "sounds"
    sounds.mkdir()
    for name in ("one.wav", "one.FLAC"):
        (sounds / name).write_bytes(b"sound")
    message = animate_refused(capsys, folder, audio=sounds, out=folder / "out" / "{name}.npz")
    assert "one.npz" in message and "suffix alone" in message


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("nothing.obj", ""),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("beyond.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("letter.obj", "Dear reader, this is no mesh at all.\n"),
        ("face.fbx", "binary"),
    ],
)
def test_bad_mesh_is_named(
    capsys: pytest.CaptureFixture[str], folder: Path, name: str, content: str
) -> None:
    (folder / name).write_text(content)
    assert name in animate_refused(capsys, folder, mesh=folder / name)


def test_missing_mesh_is_named(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert "ghost.ply" in animate_refused(capsys, folder, mesh=folder / "ghost.ply")


def test_unknown_weights_list_the_installed_ones(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    message = animate_refused(capsys, folder, pretrained="enormous")
    assert "'enormous'" in message and "talker.json" in message


# ---- outputs -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["talk.avi", "talk", "talk.wav"])
def test_unknown_output_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], folder: Path, name: str
) -> None:
    message = animate_refused(capsys, folder, out=folder / "out" / name, audio="not_there.wav")
    assert name in message and ".glb" in message


def test_single_mesh_as_output_suggests_a_folder() -> None:
    with pytest.raises(ValueError, match=r"'talk/\*\.obj'"):
        parse_output("out/talk.obj")


def test_outputs_are_understood_by_name(tmp_path: Path) -> None:
    assert parse_output("a/talk.GLB") == Output(Path("a/talk.GLB"), "glb")
    assert parse_output("a/talk.mp4") == Output(Path("a/talk.mp4"), "mp4")
    assert parse_output("frames/") == Output(Path("frames"), "obj")
    assert parse_output("frames/*.ply") == Output(Path("frames"), "ply")
    assert parse_output(str(tmp_path)) == Output(tmp_path, "obj")


def test_unwritable_output_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    target = folder / "speech.wav" / "deeper" / "talk.glb"
    message = animate_refused(capsys, folder, out=target, audio="not_there.wav")
    assert "cannot write" in message and "is not a folder" in message


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs a folder that nobody can write")
def test_protected_folder_is_refused(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert "cannot write" in animate_refused(capsys, folder, out="/proc/self/talk.glb")


def test_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "talk.glb").mkdir()
    with pytest.raises(OSError, match="it is a folder"):
        check_writable(tmp_path / "talk.glb")


def test_trying_an_output_leaves_nothing_behind(tmp_path: Path) -> None:
    check_writable(tmp_path / "deep" / "er" / "talk.glb")
    check_writable(tmp_path / "frames", is_folder=True)
    assert not list(tmp_path.iterdir())


def test_same_output_twice_is_refused(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    out = str(folder / "out" / "talk.glb")
    message = refused(capsys, folder, "animate", "--audio", "a.wav", "--out", out, "--out", out)
    assert "twice" in message


def test_inputs_are_not_written_over(
    capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("talk.speech.wav", "talk.bin", "talk.mp4", "frames/frame_00000.obj", "hero.glb"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"kept")
    pairs = [
        ("audio", "talk.speech.wav", "talk.glb"),
        ("audio", "talk.mp4", "talk.mp4"),
        ("mesh", "frames/frame_00000.obj", "frames/*.obj"),
        ("audio", "talk.bin", "talk.gltf"),
    ]
    monkeypatch.chdir(folder)
    for option, given, out in pairs:
        message = animate_refused(capsys, folder, **{option: folder / given, "out": out})
        assert "would be written over the input" in message and given in message
    assert "empty" in animate_refused(capsys, folder, out="")
    outputs = [Output(folder / "hero.glb", "glb"), Output(folder / "frames", "ply")]
    check_kept(outputs, [folder / "hero.glb", folder / "frames" / "frame_00000.obj"])


def test_axes_of_either_sign_are_understood_with_and_without_an_equals_sign() -> None:
    for words in (["--up", "-y", "--forward", "-z"], ["--up=-y", "--forward=-z"]):
        arguments = make_parser().parse_args(
            ["animate", "--audio", "a.wav", "--out", "a.glb", *words]
        )
        assert (arguments.up, arguments.forward) == ("-y", "-z")


# ---- other commands ------------------------------------------------------------------------------


def test_train_refuses_what_is_missing(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    config, out = folder / "c.yaml", folder / "out" / "run"
    common = ("--data", folder / "corpus", "--out", out)
    message = refused(capsys, folder, "train", "ats", "--config", config, *common)
    assert "c.yaml" in message
    config.write_text("model: {}\n")
    message = refused(capsys, folder, "train", "ats", "--config", config, *common)
    assert "corpus" in message
    (folder / "corpus").mkdir()
    message = refused(capsys, folder, "train", "ats", "--config", config, *common, "fast")
    assert "key=value" in message


def test_view_refuses_other_files(capsys: pytest.CaptureFixture[str], folder: Path) -> None:
    assert "ghost.npz" in refused(capsys, folder, "view", folder / "ghost.npz")
    np.savez(folder / "other.npz", x=np.zeros(3))
    message = refused(
        capsys, folder, "view", folder / "other.npz", "--png", folder / "out" / "a.png"
    )
    assert "other.npz" in message
    message = refused(
        capsys, folder, "view", folder / "other.npz", "--png", folder / "out" / "a.jpg"
    )
    assert ".png" in message


def test_errors_become_one_line() -> None:
    torch_error = RuntimeError("shapes\ndiffer\nException raised from foo at bar.cpp:3\n#0 frame")
    assert describe(torch_error) == "shapes differ"
    assert describe(FileNotFoundError(2, "No such file", "a.wav")) == "a.wav: No such file"
    assert "pyvista" in describe(ModuleNotFoundError("No module", name="pyvista"))


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", "ghost.npz", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err
