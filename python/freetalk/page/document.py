"""The page as one HTML file: nothing is fetched, so it opens from a disk without a network."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

_ASSETS = Path(__file__).parent / "assets"
#: In the order in which they need each other.
_SCRIPTS = (
    *("math.js", "take.js", "scene.js", "player.js", "timeline.js", "curves.js"),
    *("record.js", "app.js", "main.js"),
)
_PANELS = "<!--panels-->"
_OFFLINE = "connect-src 'none'"


def render_page(
    takes: Sequence[bytes], title: str, settings: Mapping[str, Any] | None = None
) -> str:
    """The page with takes inside.

    Args:
        takes: what ``pack_take`` made.
        title: of the page.
        settings: how it starts: ``truth`` (index of the take that errors are measured against).

    Returns:
        HTML, UTF-8.
    """
    blobs = "\n".join(
        f'<script type="application/octet-stream" class="take">{base64.b64encode(take).decode()}</script>'
        for take in takes
    )
    page = _fill(blobs, title, dict(settings or {}), _SCRIPTS, _OFFLINE)
    return page.replace(_PANELS, "", 1)


def render_studio(title: str) -> str:
    """The page that a server shows: without takes of its own, it may talk to where it came from."""
    scripts = (*_SCRIPTS[:-1], "pad.js", "sound.js", "live.js", "marking.js", "studio.js")
    page = _fill("", title, {}, scripts, "connect-src 'self'")
    return page.replace(_PANELS, _asset("studio.html"), 1)


def _fill(
    blobs: str, title: str, settings: dict[str, Any], scripts: Sequence[str], connections: str
) -> str:
    page = _asset("page.html")
    script = "\n".join(_asset(name) for name in scripts)
    parts = {
        "title": html.escape(title),
        "policy": connections,
        "style": _asset("page.css"),
        # "</script" inside a JSON string would end the element.
        "settings": json.dumps({"title": title} | settings).replace("<", "\\u003c"),
        "takes": blobs,
        "script": script,
    }
    for name, text in parts.items():
        before, mark, after = page.partition(f"<!--{name}-->")
        assert mark, name
        page = before + text + after
    return page


@lru_cache
def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")
