"""What strangers' files may be: which kinds, how large, and nothing that names another file."""

from __future__ import annotations

import json
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from freetalk.audio import Audio, load_audio
from freetalk.mesh import Mesh, load_mesh

MESH_SUFFIXES = (".obj", ".ply", ".off", ".stl", ".glb")
_LONGEST_NAME = 80


@dataclass(frozen=True)
class Limits:
    """How much the server takes on.

    Attributes:
        upload_bytes: of one file.
        sound_s: of one recording.
        vertices: of one mesh.
        waiting: jobs in the queue.
        kept: takes, and as many meshes and recordings.
        live: streams at a time.
        patience_s: after which the job of a page that is gone is given up.
        exports: files made for download that are kept.
    """

    upload_bytes: int = 64 << 20
    sound_s: float = 120.0
    vertices: int = 200_000
    waiting: int = 8
    kept: int = 24
    live: int = 2
    patience_s: float = 90.0
    exports: int = 12


class Refused(ValueError):
    """Something that is not taken on, with one sentence why; ``status`` is HTTP's number for it."""

    def __init__(self, message: str, status: int = 400) -> None:
        super().__init__(message)
        self.status = status


def plain_name(name: str) -> str:
    """A file's name without folders and signs that do not print."""
    last = PurePosixPath(name.replace("\\", "/")).name
    plain = "".join(sign for sign in last if sign.isprintable()).strip()
    return plain[-_LONGEST_NAME:] or "unnamed"


def read_mesh(name: str, content: bytes, limits: Limits, folder: Path | None = None) -> Mesh:
    """A mesh from the bytes of its file.

    Args:
        name: the sender's, for its kind and for people.
        content: of the file.
        limits: how large it may be.
        folder: an empty one to keep the file in: exports look up materials and the rest of a character there.

    Raises:
        Refused: another kind, too large, broken, or it names other files.
    """
    suffix = Path(plain_name(name)).suffix.lower()
    if suffix not in MESH_SUFFIXES:
        known = ", ".join(kind[1:].upper() for kind in MESH_SUFFIXES)
        raise Refused(f"'{plain_name(name)}' is not a mesh that can be sent: use {known}")
    if suffix == ".glb":
        _check_self_contained(content)
    mesh: Mesh = _read(content, suffix, load_mesh, plain_name(name), folder)
    if len(mesh.vertices) > limits.vertices:
        raise Refused(
            f"the mesh has {len(mesh.vertices):,} vertices: at most {limits.vertices:,} are taken"
        )
    mesh.name = plain_name(name)
    return mesh


def read_sound(name: str, content: bytes, limits: Limits) -> Audio:
    """Speech from the bytes of a WAV, which the page makes of whatever its browser can play.

    Raises:
        Refused: no WAV, too long, broken or empty.
    """
    if content[:4] != b"RIFF" or content[8:12] != b"WAVE":
        raise Refused(f"'{plain_name(name)}' is no WAV file")
    audio: Audio = _read(content, ".wav", load_audio, plain_name(name))
    if audio.duration_s > limits.sound_s:
        raise Refused(
            f"the recording lasts {audio.duration_s:.0f} s: at most {limits.sound_s:.0f} s are taken"
        )
    return audio


def _read(content: bytes, suffix: str, load, name: str, kept: Path | None = None):  # type: ignore[no-untyped-def]
    """What ``load`` makes of a file with this content; messages name the sender's file, not ours."""
    with tempfile.TemporaryDirectory(prefix="freetalk_") as passing:
        file = (kept or Path(passing)) / f"upload{suffix}"
        file.write_bytes(content)
        try:
            return load(file)
        except (ValueError, RuntimeError) as error:
            sentence = " ".join(str(error).split("\n")[0].split())
            raise Refused(sentence.replace(str(file), name).replace(str(file.parent), "")) from None


def _check_self_contained(content: bytes) -> None:
    """Refuses a .glb whose buffers or pictures lie in other files."""
    try:
        length = struct.unpack_from("<I", content, 12)[0]
        document = json.loads(content[20 : 20 + length])
        parts = [*document.get("buffers", []), *document.get("images", [])]
        addresses = [str(part["uri"]) for part in parts if "uri" in part]
    except (struct.error, ValueError, TypeError, AttributeError):
        raise Refused("the .glb file is damaged") from None
    if any(not address.startswith("data:") for address in addresses):
        raise Refused("the .glb file names other files: save it with everything inside")
