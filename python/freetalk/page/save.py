"""Pages: HTML with scripts, styles and takes in it, and animations to one page."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from freetalk._files import write_text
from freetalk.exports.expression import arkit_curves, find_landmarks
from freetalk.page.take import Phones, pack_take
from freetalk.viz.sequence import as_sequence

if TYPE_CHECKING:
    from freetalk.animation import Animation

#: Of the options of a performance, those that the page lists.
_LISTED = (
    "emotion",
    "intensity",
    "seed",
    "mouth_temperature",
    "articulation",
    "sampler",
    "num_steps",
)


def make_page(
    animations: Animation | Mapping[str, Animation],
    *,
    title: str = "",
    truth: Animation | None = None,
    tolerance_mm: float = 0.1,
    expression: bool = True,
    phones: Phones = (),
    colors: NDArray[Any] | None = None,
    texture: str | os.PathLike[str] | None = None,
) -> str:
    """A page that plays animations, compares them and measures them.

    Args:
        animations: one, or several by name.
        title: of the page; by default the names.
        truth: an animation of the same mesh: the page colours the others by their distance from it.
        tolerance_mm: largest error of a vertex in the page, which says what was reached.
        expression: finds landmarks and ARKit's weights of aligned faces (about a second for each mesh).
        phones: (start, end, label) in seconds, under the waveform.
        colors: (V, 3) colours of the vertices, uint8 or in [0, 1].
        texture: PNG, JPEG or WebP for the mesh's texture coordinates.

    Returns:
        HTML that fetches nothing.

    Raises:
        ValueError: no animation, or what is given beside does not fit the mesh.
        OSError: the texture cannot be read.
    """
    named = dict(animations) if isinstance(animations, Mapping) else {title or "talk": animations}
    if not named:
        raise ValueError("a page needs an animation")
    settings: dict[str, Any] = {}
    if truth is not None:
        settings["truth"] = len(named)
        named["truth" if "truth" not in named else "the truth"] = truth
    picture = None if texture is None else Path(texture)
    marks: NDArray[Any] | None = None
    marked: NDArray[Any] | None = None  # the rest pose that the marks were found on
    takes = []
    for name, animation in named.items():
        sequence = as_sequence(animation)
        if expression and (marked is None or not np.array_equal(marked, sequence.vertices)):
            marks, marked = find_landmarks(sequence), sequence.vertices
        takes.append(
            pack_take(
                animation,
                name=name,
                tolerance_mm=tolerance_mm,
                landmarks=marks,
                curves=None if marks is None else arkit_curves(sequence, marks),
                phones=phones,
                colors=colors,
                texture=picture,
                facts=listed_facts(animation.metadata),
            )
        )
    return render_page(takes, title or ", ".join(named), settings)


def save_page(
    animations: Animation | Mapping[str, Animation], path: str | os.PathLike[str], **options: Any
) -> None:
    """Writes :func:`make_page` to a file, atomically; ``animation.save("talk.html")`` calls it.

    Args:
        animations: one, or several by name.
        path: where to write.
        options: those of :func:`make_page`; the title is the file's name unless given.

    Raises:
        ValueError: as :func:`make_page`.
        OSError: a file cannot be read or written.
    """
    options.setdefault("title", Path(path).stem)
    write_text(Path(path), make_page(animations, **options))


def listed_facts(metadata: Mapping[str, Any]) -> dict[str, str]:
    """What the page says of how an animation was made."""
    options = metadata.get("options")
    if not isinstance(options, Mapping):
        return {}
    return {
        name.replace("_", " ").capitalize(): str(options[name])
        for name in _LISTED
        if options.get(name) is not None
    }


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
