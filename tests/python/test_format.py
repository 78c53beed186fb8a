"""C++ and Python are formatted, linted and type-checked by the pinned tools."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent
CPP = ("include", "src", "python/bindings", "tests/cpp", "tests/consumer")
PYTHON = ("python", "scripts", "tests")
REMEDY = "scripts/format mends what can be mended without thought"


def run(tool: str, *arguments: str) -> None:
    """Runs `tool` of this environment from the checkout's root; its output is the failure message."""
    program = BIN / tool
    if not program.exists():
        pytest.skip(f"{tool} is not installed beside {sys.executable}: run scripts/setup --tests")
    result = subprocess.run(
        [program, *arguments], cwd=ROOT, capture_output=True, text=True, check=False
    )
    output = result.stdout + result.stderr
    assert result.returncode == 0, (
        f"{tool} {' '.join(arguments[:2])} found ({REMEDY}):\n{output[-6000:]}"
    )


def test_cpp_is_formatted() -> None:
    files = [
        str(path.relative_to(ROOT))
        for folder in CPP
        for suffix in ("*.h", "*.cpp")
        for path in sorted((ROOT / folder).rglob(suffix))
        if "build" not in path.relative_to(ROOT).parts
    ]
    assert files
    run("clang-format", "--dry-run", "-Werror", *files)


def test_python_is_formatted() -> None:
    run("ruff", "format", "--check", *PYTHON)


def test_python_is_linted() -> None:
    run("ruff", "check", *PYTHON)


@pytest.mark.slow
def test_python_is_typed() -> None:
    run("mypy", "--config-file", "pyproject.toml")
