"""Files that a reader sees whole or not at all, and hashes of what is in them."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which takes its place once it is on the disk.

    Readers see the old file or the new one; a writer that fails leaves the old one. Several processes and
    threads may write the same path: one of them is last. The folder is made if it is missing.

    Args:
        path: what is replaced; the temporary file ends as it does.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = beside(path)
    try:
        yield temporary
        flush(temporary)
        temporary.replace(path)
        flush(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def beside(path: Path) -> Path:
    """A hidden name that nothing has, in the same folder and ending alike.

    Random: the numbers of processes and threads repeat in containers that share a folder.
    """
    return path.with_name(f".{path.stem}.{secrets.token_hex(8)}{path.suffix}")


def flush(path: Path) -> None:
    """Waits until a file's content, or a folder's list of names, has reached the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Writes a text file, see :func:`replacing`."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Writes a JSON file, see :func:`replacing`."""
    write_text(path, json.dumps(value, indent=2) + "\n")


def content_hash(*paths: Path) -> str:
    """Hash of the content of files, and of all files of folders with their names, 16 hexadecimal digits.

    A file that did not change since (the system's own time of change says so) is read once a process.

    Raises:
        OSError: a file is missing or not readable.
    """
    digest = hashlib.sha256()
    for path in paths:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        for file in files:
            state = file.stat()
            name = file.relative_to(path).as_posix() if path.is_dir() else ""
            digest.update(
                f"{name} {_hash(file, state.st_ino, state.st_size, state.st_ctime_ns)}\n".encode()
            )
    return digest.hexdigest()[:16]


@lru_cache(maxsize=4096)
def _hash(path: Path, inode: int, size: int, changed_ns: int) -> str:
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 22):
            digest.update(block)
    return digest.hexdigest()
