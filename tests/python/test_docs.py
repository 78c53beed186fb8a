"""What the pages show is what the library does: commands parse, Python runs, links lead somewhere."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import freetalk
from freetalk.cli.parser import make_parser
from freetalk.corpus import assets

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
#: Pages whose Python is run as it stands; that of the README shows names of what a user has.
RUN = ("outputs.md", "live.md")


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of a page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)


def commands(page: Path) -> list[str]:
    """Every line that calls ``freetalk``, without its comment."""
    lines = "\n".join(blocks(page, "bash")).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.startswith("freetalk ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_are_understood(page: Path) -> None:
    for line in commands(page):
        words = shlex.split(line, comments=True)[1:]
        if "--help" not in words:
            make_parser().parse_args(words)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if "://" not in target and not target.startswith("api/cpp/"):  # made by Doxygen
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_python_reference_names_modules_that_exist() -> None:
    text = (ROOT / "docs" / "api" / "python.md").read_text()
    for name in re.findall(r"^::: freetalk\.(\S+)$", text, re.MULTILINE):
        places = [
            ROOT / "python/freetalk" / (path + end)
            for path in (name.replace(".", "/"), name.rpartition(".")[0].replace(".", "/"))
            for end in (".py", "/__init__.py")
        ]
        assert any(place.is_file() for place in places), name


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("doxygen") is None, reason="the reference needs Doxygen")
def test_the_pages_build(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="the pages need freetalk[docs]")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    broken = [line for line in found.stderr.splitlines() if "Doc file '" in line]
    assert [line for line in broken if "api/cpp" not in line and "'../results/" not in line] == []
    reference = (tmp_path / "api/python/index.html").read_text()
    assert ":meth:" not in reference and ":class:" not in reference
    for name in ("talker.Talker", "facetalk.FaceTalk", "head.ParametricHead", "metrics"):
        assert f'id="freetalk.{name}"' in reference


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_python_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    samples = np.asarray(freetalk.load_audio(assets.speech_clip()).samples)[8000:24000]
    freetalk.audio.save_wav("speech.wav", freetalk.Audio(samples, 16000))
    vertices, faces = assets.mean_face("narrow")
    mesh = freetalk.Mesh(vertices.astype(np.float64), faces.tolist())
    freetalk.mesh.save_mesh("face.obj", mesh)
    known: dict[str, object] = {}
    for block in blocks(ROOT / "docs" / page, "python"):
        exec(block, known)
    if page == "outputs.md":
        report = known["report"]
        assert report.morph_error_mm <= 0.1 and report.num_morph_targets > 51  # type: ignore[attr-defined]
        assert {"talk.glb", "talk.usda", "talk.csv"} <= {path.name for path in tmp_path.iterdir()}
