"""What is read and where results go: understood and tried before any work begins."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

ANIMATION_SUFFIXES = (
    *(".glb", ".gltf", ".usda", ".usdc", ".usdz", ".usd", ".html", ".npz", ".pc2"),
    *(".mp4", ".webm", ".csv", ".json"),
)
VIDEO_FORMATS = ("mp4", "webm")
#: Morph targets and blend shapes, which --rig and --compact concern.
RIG_FORMATS = ("glb", "gltf", "usda", "usdc", "usdz", "usd")
FRAME_SUFFIXES = (".obj", ".ply")
MESH_SUFFIXES = (".obj", ".ply", ".off", ".stl", ".gltf", ".glb")


@dataclass(frozen=True)
class Output:
    """One requested result.

    Attributes:
        path: The file, or the folder of a mesh a frame.
        format: the extension in lower case, ``obj`` or ``ply`` for a folder.
    """

    path: Path
    format: str

    @property
    def is_folder(self) -> bool:
        """Whether frames are written as single meshes."""
        return self.format in ("obj", "ply")


def parse_output(text: str) -> Output:
    """Understands one ``--out``.

    Raises:
        ValueError: The name does not say what to write.
    """
    if not text.strip():
        raise ValueError("--out is empty: give a file or a folder")
    path = Path(text)
    suffix = path.suffix.lower()
    if path.stem == "*" and suffix in FRAME_SUFFIXES:
        return Output(path.parent, suffix[1:])
    if text.endswith(("/", os.sep)) or (not suffix and path.is_dir()):
        return Output(path, "obj")
    if suffix in FRAME_SUFFIXES:
        raise ValueError(
            f"'{text}' is one mesh but an animation is many: give a folder, '{path.stem}/*{suffix}'"
        )
    if suffix not in ANIMATION_SUFFIXES:
        known = ", ".join(ANIMATION_SUFFIXES)
        raise ValueError(
            f"'{text}' does not say what to write: end it in {known}, or give a folder ('frames/', "
            "'frames/*.obj', 'frames/*.ply')"
        )
    return Output(path, suffix[1:])


def parse_outputs(texts: list[str]) -> list[Output]:
    """Understands every ``--out`` and makes sure that each can be written."""
    outputs = [parse_output(text) for text in texts]
    for output in outputs:
        check_writable(output.path, output.is_folder)
    if len({output.path.absolute() for output in outputs}) < len(outputs):
        raise ValueError("the same --out is given twice")
    return outputs


def check_kept(outputs: list[Output], given: list[Path]) -> None:
    """Makes sure that no input is written over; a glTF's motion may go into its own file.

    Raises:
        ValueError: one would be.
    """
    for output in outputs:
        path = output.path
        beside = [path.parent / f"{path.stem}{end}" for end in (".speech.wav", ".bin")]
        own = output.format in ("glb", "gltf")
        for file in given:
            frame = output.is_folder and file.match(f"frame_*.{output.format}")
            into = file.parent if frame else file
            written = [path, *(beside if output.format in RIG_FORMATS else [])]
            if own and file.suffix.lower() in (".glb", ".gltf"):
                written = beside[:1]
            if any(into.resolve() == one.resolve() for one in written):
                raise ValueError(
                    f"'{path}' would be written over the input '{file}': choose another --out"
                )


def check_writable(path: Path, is_folder: bool = False) -> None:
    """Tries whether a file or folder can be made; leaves nothing behind.

    Raises:
        OSError: It cannot, with one sentence why.
    """
    if path.is_dir() and not is_folder:
        raise OSError(f"cannot write '{path}': it is a folder")
    folder = path if is_folder else path.parent
    ancestor = folder.absolute()
    while not ancestor.exists() and ancestor != ancestor.parent:
        ancestor = ancestor.parent
    if not ancestor.is_dir():
        raise OSError(f"cannot write '{path}': '{ancestor}' is not a folder")
    try:
        with tempfile.TemporaryFile(dir=ancestor, prefix=".freetalk_"):
            pass
    except OSError as error:
        raise OSError(f"cannot write '{path}': {error.strerror} in '{ancestor}'") from error
    if path.is_file() and not os.access(path, os.W_OK):
        raise OSError(f"cannot write '{path}': the file that is there is protected")


def check_readable(path: str, what: str) -> Path:
    """Makes sure that an input file is there and holds something.

    Raises:
        OSError: It is missing, a folder, empty or protected.
    """
    file = Path(path)
    if file.is_dir():
        raise OSError(f"'{path}' is a folder: give {what}")
    if not file.exists():
        raise OSError(f"'{path}' does not exist: give {what}")
    if file.is_file() and file.stat().st_size == 0:
        raise OSError(f"'{path}' is empty: give {what}")
    if not os.access(file, os.R_OK):
        raise OSError(f"'{path}' may not be read: change its permissions or give {what}")
    return file


def inputs(path: str, suffixes: tuple[str, ...], what: str) -> list[Path]:
    """An input file, or the files of a folder that end in one of `suffixes`, sorted.

    Raises:
        OSError: it is missing, empty or protected, or the folder has none.
    """
    if not Path(path).is_dir():
        return [check_readable(path, what)]
    found = [file for file in sorted(Path(path).iterdir()) if file.suffix.lower() in suffixes]
    if not found:
        raise OSError(f"the folder '{path}' holds no {', '.join(suffixes)}: give {what}")
    return [check_readable(str(file), what) for file in found]
