"""`cmake --install` makes a package that a C++ tool finds, links and runs, without Python."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

import freetalk

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build"
BIN = Path(sys.executable).parent
MESH_V, MESH_F = 24, 18  # rows and columns of a bent sheet about as large as a face


def call(*command: object, cwd: Path | None = None) -> str:
    """Runs a command; its output, also as the message if it fails."""
    environment = {
        key: value
        for key, value in os.environ.items()
        if key not in ("PYTHONPATH", "LD_LIBRARY_PATH")
    }
    result = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**environment, "PATH": f"{BIN}:{environment['PATH']}"},
        capture_output=True,
        text=True,
        check=False,
    )
    output = result.stdout + result.stderr
    assert result.returncode == 0, f"{' '.join(map(str, command))}\n{output[-4000:]}"
    return output


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An install tree made from the build folder, at a path the build does not know."""
    if not (BUILD / "cmake_install.cmake").exists():
        pytest.skip("no build folder: run scripts/setup --tests")
    folder = tmp_path_factory.mktemp("install") / "freetalk"
    call(BIN / "cmake", "--install", BUILD, "--prefix", folder, "--component", "development")
    return folder


def build_consumer(prefix: Path, folder: Path, without_link_libraries: bool = False) -> Path:
    """tests/consumer, copied out of the tree and built against the install tree.

    No header-only library is found but Eigen; with `without_link_libraries` nor is what freetalk links.
    """
    hidden = ["nlohmann_json", "Spectra"] + ["PkgConfig"] * without_link_libraries
    shutil.copytree(ROOT / "tests" / "consumer", folder / "source")
    # fmt: off
    call(BIN / "cmake", "-S", folder / "source", "-B", folder / "build", "-G", "Ninja",
         f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_BUILD_TYPE=Debug",
         f"-DCMAKE_MAKE_PROGRAM={BIN / 'ninja'}",
         *(f"-DCMAKE_DISABLE_FIND_PACKAGE_{name}=ON" for name in hidden))
    # fmt: on
    call(BIN / "cmake", "--build", folder / "build")
    return folder / "build" / "consumer"


@pytest.fixture(scope="module")
def consumer(prefix: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_consumer(prefix, tmp_path_factory.mktemp("consumer"))


@pytest.fixture
def sheet_and_tone(tmp_path: Path) -> tuple[Path, Path]:
    """A curved sheet, 18 cm high, as OBJ; half a second of a 150 Hz tone as WAV."""
    rows, columns = np.mgrid[-1 : 1 : MESH_V * 1j, -1 : 1 : MESH_F * 1j]
    points = np.stack(
        [0.07 * columns, 0.09 * rows, 0.05 * (1 - columns**2) - 0.02 * rows**2], axis=-1
    )
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in points.reshape(-1, 3)]
    for row in range(MESH_V - 1):
        for column in range(MESH_F - 1):
            a = row * MESH_F + column + 1
            lines.append(f"f {a} {a + 1} {a + MESH_F + 1} {a + MESH_F}")
    mesh = tmp_path / "sheet.obj"
    mesh.write_text("\n".join(lines) + "\n")
    tone = tmp_path / "tone.wav"
    time_s = np.arange(8000) / 16000
    soundfile.write(tone, 0.3 * np.sin(2 * np.pi * 150 * time_s), 16000)
    return mesh, tone


def test_install_tree_holds_headers_targets_and_weights(prefix: Path) -> None:
    assert (prefix / "include/freetalk/core/error.h").exists()
    assert list(prefix.glob("lib*/**/freetalkConfig.cmake"))
    installed = {path.name for path in (prefix / "share/freetalk/pretrained").glob("*")}
    shipped = {
        path.name for path in (ROOT / "python/freetalk/pretrained").iterdir() if path.is_dir()
    }
    assert installed == shipped


def test_install_tree_does_not_know_the_build_folder(prefix: Path) -> None:
    for path in prefix.glob("lib*/cmake/freetalk/*.cmake"):
        text = path.read_text()
        assert str(BUILD) not in text, path
        assert str(ROOT / "include") not in text, path


def test_consumer_animates_a_mesh(
    consumer: Path, sheet_and_tone: tuple[Path, Path], tmp_path: Path
) -> None:
    mesh, tone = sheet_and_tone
    output = call(consumer, mesh, tone, tmp_path / "out.npz", cwd=tmp_path)
    said = dict(re.findall(r"^(\w+) (\S+)$", output, re.MULTILINE))
    assert int(said["vertices"]) == MESH_V * MESH_F
    assert float(said["normals_unit"]) < 1e-12
    assert int(said["frames"]) == 15
    assert 0 < float(said["largest_motion"]) < 0.1  # metres
    with np.load(tmp_path / "out.npz") as arrays:
        assert (15, MESH_V * MESH_F, 3) in [arrays[name].shape for name in arrays.files]


def test_consumer_says_what_is_wrong_in_one_sentence(consumer: Path, tmp_path: Path) -> None:
    result = subprocess.run(
        [consumer, tmp_path / "missing.obj", tmp_path / "missing.wav", tmp_path / "out.npz"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 1
    assert "missing.obj" in result.stderr
    assert not (tmp_path / "out.npz").exists()


@pytest.fixture(scope="module")
def shared_prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An install tree of shared libraries; the compiler's cache has their units from the static ones."""
    if shutil.which("ccache") is None:
        pytest.skip("without ccache every unit is compiled again")
    build = ROOT / "build-shared"
    unity = re.search(r"^FREETALK_UNITY:BOOL=(\w+)$", (BUILD / "CMakeCache.txt").read_text(), re.M)
    # fmt: off
    call(BIN / "cmake", "-S", ROOT, "-B", build, "-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={BIN / 'ninja'}",
         "-DBUILD_SHARED_LIBS=ON", f"-DFREETALK_UNITY={unity[1] if unity else 'OFF'}",
         "-DFREETALK_BUILD_PYTHON=OFF", "-DFREETALK_BUILD_TESTS=OFF", f"-DPython_EXECUTABLE={sys.executable}")
    # fmt: on
    call(BIN / "cmake", "--build", build)
    folder = tmp_path_factory.mktemp("install") / "shared"
    call(BIN / "cmake", "--install", build, "--prefix", folder, "--component", "development")
    return folder


@pytest.mark.slow
def test_consumer_of_shared_libraries_needs_no_library_of_ours(
    shared_prefix: Path, sheet_and_tone: tuple[Path, Path], tmp_path: Path
) -> None:
    mesh, tone = sheet_and_tone
    moved = shared_prefix.rename(shared_prefix.with_name("moved"))
    consumer = build_consumer(moved, tmp_path / "consumer", without_link_libraries=True)
    output = call(consumer, mesh, tone, tmp_path / "out.npz", cwd=tmp_path)
    assert re.search(r"^frames 15$", output, re.MULTILINE)


def test_another_torch_is_refused_by_find_package(prefix: Path, tmp_path: Path) -> None:
    other = tmp_path / "torch"
    headers = other / "include/torch/headeronly"
    headers.mkdir(parents=True)
    (headers / "version.h").write_text(
        "#define TORCH_VERSION_MAJOR 1\n#define TORCH_VERSION_MINOR 0\n#define TORCH_VERSION_PATCH 0\n"
    )
    (other / "lib").mkdir()
    for library in ("torch", "torch_cpu", "c10"):
        (other / "lib" / f"lib{library}.so").touch()
    source = tmp_path / "source"
    source.mkdir()
    (source / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.24)\nproject(refused LANGUAGES CXX)\nfind_package(freetalk REQUIRED)\n"
    )
    # fmt: off
    result = subprocess.run(
        [BIN / "cmake", "-S", source, "-B", tmp_path / "build", "-G", "Ninja",
         f"-DCMAKE_MAKE_PROGRAM={BIN / 'ninja'}", f"-DCMAKE_PREFIX_PATH={prefix}",
         f"-DFREETALK_TORCH_DIR={other}"],
        capture_output=True, text=True, check=False,
    )
    # fmt: on
    assert result.returncode != 0
    built_with = freetalk._native.torch_version
    said = " ".join(result.stderr.split())
    assert f"freetalk was built with torch {built_with} but found torch 1.0.0" in said
