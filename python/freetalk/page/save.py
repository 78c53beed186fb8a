"""Animations to one page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from freetalk._files import write_text
from freetalk.exports.expression import arkit_curves, find_landmarks
from freetalk.page.document import render_page
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
