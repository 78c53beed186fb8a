"""The rooms depend on each other in one direction only, and files stay small enough to read."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# A room, and the rooms whose headers and modules it may use; bottom to top.
ROOMS: dict[str, set[str]] = {
    "core": set(),
    "audio": {"core"},
    "kernels": {"core"},
    "mesh": {"core"},
    "geometry": {"core", "kernels", "mesh"},
    "nn": {"core", "kernels", "mesh", "geometry"},
    "speech": {"core", "audio", "kernels", "nn"},
    "diffusion": {"core"},
    "ats": {"core", "speech", "diffusion", "nn"},
    "stm": {"core", "mesh", "nn", "geometry"},
    "head": {"core", "nn", "geometry"},
    "rig": {"core", "geometry"},
    "facetalk": {"core", "speech", "diffusion", "nn", "geometry"},
    "metrics": {"core"},
    "animation": {"core", "audio", "mesh", "geometry"},
    "talker": {
        "core", "audio", "mesh", "geometry", "nn", "speech", "diffusion", "ats", "stm", "head", "rig",
        "facetalk", "metrics", "animation",
    },
}  # fmt: skip

# Who knows of kernels and their instruction sets; the rooms above ask these.
KERNEL_CALLERS = {"geometry", "nn", "speech"}

# Python that only orchestrates rooms: a higher line may use a lower one, and any room.
PYTHON_LAYERS: dict[str, int] = {
    "viz": 1,
    "data": 1,
    "corpus": 2,
    "exports": 3,
    "page": 4,
    "prepare": 3,
    "faces": 3,
    "train": 3,
    "video": 3,
    "evaluate": 4,
    "tables": 5,
    "serve": 5,
    "cli": 6,
}
# Upward uses that are meant: imported inside a function, only when that function is asked for.
ON_DEMAND = {
    ("animation", "viz"),  # save("talk.mp4")
    ("animation", "page"),  # save("talk.html")
    ("animation", "exports"),  # save("talk.usdc"), save("talk.csv")
    ("talker", "data"),  # landmarks from a file
    ("talker", "faces"),  # the face of a mesh whose shape leaves it in doubt
}

HEADER_LINES, SOURCE_LINES = 150, 400
INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)
# Third-party headers that stay out of public headers: compiling them is slow, or they are not everywhere.
PRIVATE_HEADERS = re.compile(
    r"^(torch/(torch|extension|all|nn)\.h|OpenMesh/|Spectra/|sndfile|samplerate|nlohmann/|tiny_gltf)"
)


def cpp_files() -> list[tuple[str, Path]]:
    """(room, file) of every C++ file that belongs to a room."""
    found = []
    for pattern in ("include/freetalk/*/*.h", "src/*/*.cpp", "src/*/*.h", "tests/cpp/*/*.cpp"):
        found += [(path.parent.name, path) for path in sorted(ROOT.glob(pattern))]
    return [(room, path) for room, path in found if room != "cmake"]


def included_rooms(path: Path) -> set[str]:
    """Rooms whose headers `path` includes: public ones (freetalk/mesh/...), internal ones (mesh/...)."""
    folders = [header.split("/") for header in INCLUDE.findall(path.read_text())]
    return {names[1] if names[0] == "freetalk" else names[0] for names in folders} & set(ROOMS)


def imported_modules(path: Path, inside_functions: bool = True) -> set[str]:
    """First names below `freetalk` that a module of the package imports."""
    package = path.relative_to(ROOT / "python").with_suffix("").parts[:-1]
    found: set[str] = set()
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree) if inside_functions else tree.body:
        names: list[tuple[str, ...]] = []
        if isinstance(node, ast.Import):
            names = [tuple(alias.name.split(".")) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = base + tuple((node.module or "").split(".") if node.module else ())
            names = [module] if len(module) > 1 else [module + (a.name,) for a in node.names]
            if module == ("freetalk", "_native"):
                names = [("freetalk", alias.name) for alias in node.names]
        for name in names:
            if name[0] == "freetalk" and len(name) > 1:
                found.add(name[2] if name[1] == "_native" and len(name) > 2 else name[1])
    return found


def python_modules() -> list[tuple[str, Path]]:
    """(first name below freetalk, file) of every module of the package."""
    package = ROOT / "python" / "freetalk"
    files = sorted(
        path for path in package.rglob("*.py") if path.parent != package or path.stem != "__init__"
    )
    return [(path.relative_to(package).with_suffix("").parts[0], path) for path in files]


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_rooms_are_listed_bottom_to_top() -> None:
    seen: set[str] = set()
    for room, uses in ROOMS.items():
        assert uses <= seen, f"{room} uses {uses - seen}, listed above it"
        seen.add(room)


def test_every_cpp_folder_is_a_known_room() -> None:
    assert {room for room, _ in cpp_files()} <= set(ROOMS)


def test_cpp_includes_only_lower_rooms() -> None:
    upward = [
        f"{relative(path)} includes freetalk/{used}/"
        for room, path in cpp_files()
        for used in sorted(included_rooms(path) - ROOMS[room] - {room})
    ]
    assert not upward, "\n".join(upward)


def test_public_headers_include_only_public_headers() -> None:
    internal = [
        f"{relative(path)} includes {header}"
        for path in sorted(ROOT.glob("include/freetalk/*/*.h"))
        for header in INCLUDE.findall(path.read_text())
        if not header.startswith("freetalk/")
        and (header.split("/")[0] in ROOMS or "/" not in header)
        if header.endswith(".h")
    ]
    assert not internal, "\n".join(internal)


def test_internal_includes_name_a_header_of_src() -> None:
    missing = [
        f"{relative(path)} includes {header}"
        for _, path in cpp_files()
        for header in INCLUDE.findall(path.read_text())
        if header.split("/")[0] in ROOMS and not (ROOT / "src" / header).exists()
    ]
    assert not missing, "\n".join(missing)


def test_kernels_are_called_by_the_rooms_right_above_them_alone() -> None:
    callers = {room for room, path in cpp_files() if "kernels" in included_rooms(path)}
    assert callers <= KERNEL_CALLERS | {"kernels"}
    assert not list((ROOT / "include").rglob("kernels"))


def test_cmake_links_only_lower_rooms() -> None:
    text = (ROOT / "src/cmake/rooms.cmake").read_text()
    calls = re.findall(r"^freetalk_add_room\((\w+)([^)]*)\)", text, re.MULTILINE)
    assert {room for room, _ in calls} >= {room for room, _ in cpp_files()}
    for room, arguments in calls:
        used = re.search(r"USES((?:\s+[a-z]+)+)", arguments)
        linked = set(used.group(1).split()) if used else set()
        assert linked <= ROOMS[room], f"freetalk_{room} links {linked - ROOMS[room]}"


def test_bindings_include_only_their_room_and_lower_ones() -> None:
    upward = [
        f"{relative(path)} includes freetalk/{used}/"
        for room in ROOMS
        for path in sorted((ROOT / "python/bindings").glob(f"{room}*.cpp"))
        for used in sorted(included_rooms(path) - ROOMS[room] - {room})
    ]
    assert not upward, "\n".join(upward)


def test_public_headers_leave_heavy_third_party_headers_out() -> None:
    heavy = [
        f"{relative(path)} includes {header}"
        for path in sorted(ROOT.glob("include/freetalk/*/*.h"))
        for header in INCLUDE.findall(path.read_text())
        if PRIVATE_HEADERS.match(header)
    ]
    assert not heavy, "\n".join(heavy)


def test_python_imports_only_lower_modules() -> None:
    upward = []
    for name, path in python_modules():
        for used in sorted(imported_modules(path) - {name}):
            if (name, used) in ON_DEMAND:
                allowed = used not in imported_modules(path, inside_functions=False)
            elif name in ROOMS:
                allowed = used in ROOMS[name] or used.startswith("_")
            elif name in PYTHON_LAYERS:
                allowed = PYTHON_LAYERS.get(used, 0) < PYTHON_LAYERS[name]
            else:  # private helpers such as freetalk._module serve every room
                allowed = used.startswith("_") or used in ("core",)
            if not allowed:
                upward.append(f"{relative(path)} imports freetalk.{used}")
    assert not upward, "\n".join(upward)


@pytest.mark.parametrize(
    ("pattern", "limit"),
    [
        ("include/freetalk/*/*.h", HEADER_LINES),
        ("python/bindings/*.h", HEADER_LINES),
        ("src/*/*.cpp", SOURCE_LINES),
        ("src/*/*.h", SOURCE_LINES),
        ("python/bindings/*.cpp", SOURCE_LINES),
        ("python/freetalk/**/*.py", SOURCE_LINES),
        ("scripts/**/*.py", SOURCE_LINES),
    ],
)
def test_files_stay_short(pattern: str, limit: int) -> None:
    lengths = {relative(path): len(path.read_text().splitlines()) for path in ROOT.glob(pattern)}
    too_long = {name: length for name, length in lengths.items() if length > limit}
    assert not too_long, f"more than {limit} lines: {too_long}"


def test_no_unfinished_work_is_left() -> None:
    marks = re.compile(r"\b(TODO|FIXME|XXX)\b|NotImplementedError")
    found = [
        f"{relative(path)}:{number}: {line.strip()}"
        for folder in ("include", "src", "python", "scripts", "configs")
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in {".h", ".cpp", ".py", ".cmake", ".yaml"}
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if marks.search(line)
    ]
    assert not found, "\n".join(found)


def test_threads_have_one_door_and_instruction_sets_one_switch() -> None:
    """core/parallel.h starts every thread; only the kernels know what the processor offers."""
    threads = re.compile(
        r"\bat::parallel_for\b|\bstd::j?thread\b|#\s*pragma\s+omp\b|[<\"]omp\.h[>\"]"
    )
    sets = re.compile(r"target_clones|__builtin_cpu_supports|immintrin\.h|GCC target")
    found = []
    for folder in ("include", "src", "python/bindings"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix not in {".h", ".cpp", ".inc"}:
                continue
            text = path.read_text()
            if threads.search(text) and relative(path) != "src/core/parallel.cpp":
                found.append(f"{relative(path)} starts threads of its own")
            if sets.search(text) and path.parent != ROOT / "src/kernels":
                found.append(f"{relative(path)} chooses an instruction set")
    assert not found, "\n".join(found)
