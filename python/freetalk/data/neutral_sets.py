"""BIWI_6 and Multiface in ScanTalk's layout, BIWI in FaceFormer's; neutral speech, intensity 1.

``vertices/SPEAKER_*.npy`` (T, V, 3) or (T, 3 V), ``wav/SPEAKER_*.wav``, ``templates/SPEAKER.obj`` (BIWI_6) or
``.ply`` (Multiface), ``mouth_indices.npy`` and ``upper_indices.npy``. BIWI_6 runs at 25 fps, Multiface at 30.
BIWI's emotional takes (``F1_e01``) are left out, as ScanTalk does.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from freetalk.data.layouts import (
    FileName,
    Request,
    common_size,
    find_faces,
    paired_recordings,
    read_neutral,
    registered_parts,
)
from freetalk.data.registered import RegisteredParts

_BIWI_NAME = re.compile(r"(?P<speaker>[FM]\d+)_(?P<sentence>\d+)\Z")
_MULTIFACE_NAME = re.compile(r"(?P<speaker>\d{8})(?:[_-].*)?\Z")


def read_biwi(request: Request) -> RegisteredParts:
    """BIWI_6 (3,895 vertices) or BIWI (23,370).

    Raises:
        DatasetError: what is missing or wrong, by name.
    """

    def parse(stem: str) -> FileName | None:
        match = _BIWI_NAME.match(stem)
        return FileName(match["speaker"], int(match["sentence"])) if match else None

    return _read(request, "biwi", parse, (25.0,))


def read_multiface(request: Request) -> RegisteredParts:
    """Multiface (5,471 vertices).

    Raises:
        DatasetError: what is missing or wrong, by name.
    """

    def parse(stem: str) -> FileName | None:
        match = _MULTIFACE_NAME.match(stem)
        return FileName(match["speaker"]) if match else None

    return _read(request, "multiface", parse, (30.0,))


def _read(
    request: Request,
    kind: str,
    parse: Callable[[str], FileName | None],
    fps: tuple[float, ...],
) -> RegisteredParts:
    neutral, faces = read_neutral(request.directory)
    triangles = find_faces(request.directory, neutral, faces, kind)
    recordings = paired_recordings(request, common_size(neutral), parse)
    notes = {"layout": "ScanTalk" if faces else "FaceFormer"}
    return registered_parts(request, kind, recordings, neutral, triangles, fps, notes)
