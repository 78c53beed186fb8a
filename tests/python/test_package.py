"""The Python package: one version, complete wheels that work anywhere, honest refusals."""

from __future__ import annotations

import importlib.metadata
import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

import freetalk

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "python" / "freetalk"
MIB = 1 << 20


def python(code: str, cwd: Path, site: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Runs `code` in a new interpreter from another folder.

    With `site`, freetalk comes from there: the checkout's own installation is left out by skipping .pth files.
    """
    command = [sys.executable, "-c", code]
    if site is not None:
        paths = [str(site), sysconfig.get_paths()["purelib"], sysconfig.get_paths()["platlib"]]
        command = [sys.executable, "-S", "-c", f"import sys\nsys.path += {paths}\n{code}"]
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def folder_size(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that `pip install .` installs.

    Its build folder lies beside that of the checkout: with the same relative paths, the compiler's cache
    that scripts/setup has filled answers for every unit.
    """
    folder = tmp_path_factory.mktemp("wheel")
    # fmt: off
    result = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--no-build-isolation", "--no-deps", "-w", folder,
         "-C", "build-dir=build-wheel", "."],
        cwd=ROOT, capture_output=True, text=True, check=False,
        env={**os.environ, "CCACHE_BASEDIR": str(ROOT)},
    )
    # fmt: on
    assert result.returncode == 0, (result.stdout + result.stderr)[-4000:]
    (made,) = folder.glob("*.whl")
    return made


def test_one_version_everywhere() -> None:
    project = re.search(r"project\(freetalk VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())
    assert project is not None
    assert freetalk.__version__ == project.group(1) == importlib.metadata.version("freetalk")


def test_command_is_installed() -> None:
    (command,) = importlib.metadata.entry_points(group="console_scripts", name="freetalk")
    assert command.value == "freetalk.cli:main"


def test_command_works_from_any_folder(tmp_path: Path) -> None:
    command = Path(sys.executable).parent / "freetalk"
    result = subprocess.run(
        [command, "--help"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert "animate" in result.stdout


def test_import_stays_quick_and_small(tmp_path: Path) -> None:
    code = (
        "import sys, freetalk\n"
        "heavy = {'pyvista', 'vtk', 'matplotlib', 'transformers', 'scipy', 'tensorboard', 'imageio'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    result = python(code, tmp_path)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_another_torch_is_refused_in_one_sentence(tmp_path: Path) -> None:
    result = python("import torch; torch.__version__ = '1.0.0'; import freetalk", tmp_path)
    assert result.returncode != 0
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError: freetalk was built with torch")
    assert "1.0.0" in last


def test_shipped_data_stays_small() -> None:
    assert folder_size(PACKAGE / "assets") <= 25 * MIB
    assert folder_size(PACKAGE / "pretrained") <= 25e6


def test_every_asset_has_licence_and_source() -> None:
    for folder in (PACKAGE / "assets").iterdir():
        if folder.is_dir():
            names = {path.name.split(".")[0].upper() for path in folder.iterdir()}
            assert {"LICENSE", "SOURCE"} <= names, folder.name


def test_wheel_is_complete(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    tracked = subprocess.run(
        ["git", "ls-files", "python/freetalk"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if tracked.returncode == 0:
        wanted = {line.removeprefix("python/") for line in tracked.stdout.split("\n") if line}
        assert wanted - names == set()
    assert sum(name.startswith("freetalk/_native.") for name in names) == 1
    assert "freetalk/py.typed" in names
    configs = {f"freetalk/configs/{path.name}" for path in (ROOT / "configs").glob("*.yaml")}
    assert configs
    assert configs <= names
    assert any(name.endswith("licenses/THIRD_PARTY_NOTICES.md") for name in names)
    strange = {name for name in names if not name.startswith(("freetalk/", "freetalk-"))}
    assert not strange


def test_wheel_works_from_any_folder(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    code = (
        "import freetalk, pathlib\n"
        "talker = freetalk.Talker.from_pretrained('open-small')\n"
        "print(pathlib.Path(freetalk.__file__).parent, pathlib.Path(freetalk._native.__file__).parent)"
    )
    result = python(code, tmp_path, site=site)
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [str(site / "freetalk")] * 2
