"""The committed type stubs of the native module name what the built one has."""

from __future__ import annotations

import ast
import inspect
from pathlib import Path
from types import ModuleType

import pytest

from freetalk import _native

STUBS = Path(__file__).resolve().parents[2] / "python" / "freetalk" / "_native"
REMEDY = "run .venv/bin/python scripts/make_stubs.py"


def stub_names(path: Path) -> set[str]:
    """Public functions, classes and `Class.member` of a stub file."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.ClassDef):
            names.add(node.name)
            for member in node.body:
                if isinstance(member, ast.FunctionDef):
                    names.add(f"{node.name}.{member.name}")
                elif isinstance(member, ast.AnnAssign) and isinstance(member.target, ast.Name):
                    names.add(f"{node.name}.{member.target.id}")
    return {name for name in names if not name.split(".")[-1].startswith("_")}


def native_names(module: ModuleType) -> set[str]:
    """The same names, of the module itself."""
    names = set()
    for name, value in vars(module).items():
        if name.startswith("_") or inspect.ismodule(value):
            continue
        if inspect.isclass(value):
            members = (member for member in vars(value) if not member.startswith("_"))
            names |= {name} | {f"{name}.{member}" for member in members}
        elif callable(value):
            names.add(name)
    return names


ROOMS = sorted(name for name, value in vars(_native).items() if inspect.ismodule(value))


@pytest.mark.parametrize("room", ROOMS)
def test_stubs_name_everything_native(room: str) -> None:
    path = STUBS / f"{room}.pyi"
    if not path.exists():
        path = STUBS / room / "__init__.pyi"
    assert path.exists(), f"no stub of freetalk._native.{room}: {REMEDY}"
    stub, native = stub_names(path), native_names(getattr(_native, room))
    assert stub == native, f"differ in {sorted(stub ^ native)}: {REMEDY}"


def test_package_is_marked_typed() -> None:
    assert (STUBS.parent / "py.typed").exists()
