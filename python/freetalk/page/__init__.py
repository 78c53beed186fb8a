"""A page that plays animations in any browser: one HTML file, no network, no library."""

from __future__ import annotations

from freetalk.exports.expression import arkit_curves, find_landmarks
from freetalk.page.save import make_page, render_page, render_studio, save_page
from freetalk.page.take import (
    PackedMotion,
    pack_motion,
    pack_rig,
    pack_take,
    read_take,
    unpack_motion,
)
from freetalk.page.viewing import PageServer

__all__ = [
    "PackedMotion",
    "PageServer",
    "arkit_curves",
    "find_landmarks",
    "make_page",
    "pack_motion",
    "pack_rig",
    "pack_take",
    "read_take",
    "render_page",
    "render_studio",
    "save_page",
    "unpack_motion",
]
