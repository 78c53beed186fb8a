"""Writes the type stubs of the native module into python/freetalk/_native.

Run it after changing python/bindings, with the native module built:  .venv/bin/python scripts/make_stubs.py
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STUBS = ROOT / "python" / "freetalk" / "_native"


def generate(out: Path) -> None:
    """Generates formatted stubs of ``freetalk._native`` into the folder ``out``, replacing it."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "pybind11_stubgen", "freetalk._native", "-o", folder],
            cwd=ROOT / "python",
            check=True,
        )
        made = Path(folder) / "freetalk" / "_native"
        for stub in made.rglob("*.pyi"):
            stub.write_text(with_callbacks(stub.read_text()))
        ruff = [sys.executable, "-m", "ruff", "format", "--config", ROOT / "pyproject.toml", made]
        subprocess.run(ruff, check=True)
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(made, out)


def with_callbacks(text: str) -> str:
    """Callbacks are given plain numbers, and those that may be left out may be None."""

    def plain(found: re.Match[str]) -> str:
        numbers = re.sub(r"typing\.SupportsFloat \| typing\.SupportsIndex", "float", found[0])
        return re.sub(r"typing\.SupportsInt \| typing\.SupportsIndex", "int", numbers)

    text = re.sub(r"Callable\[\[[^\]]*\]", plain, text)
    return re.sub(r"(Callable\[\[[^\]]*\], [^\]]*\]) = None", r"\1 | None = None", text)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--out", type=Path, default=STUBS, help="folder to write (default: %(default)s)"
    )
    generate(parser.parse_args().out)


if __name__ == "__main__":
    main()
