"""Faces coloured by numbers, and the script that draws the papers' figures with them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from freetalk import viz
from freetalk.corpus.assets import mean_face

SIZE = (120, 120)


def test_colours_follow_the_values() -> None:
    vertices, faces = mean_face("narrow")
    below = (vertices[:, 1] < 0).astype(np.float64)
    image = viz.heat_map(vertices, faces, below, (0.0, 1.0), SIZE).astype(int)
    # Of "turbo" the first colour is dark violet, more blue than red, the last a dark red.
    upper, lower = image[40, 60], image[85, 60]
    assert upper[2] > upper[0]
    assert lower[0] > 2 * lower[2]
    beyond = viz.heat_map(vertices, faces, 9 * below - 4, (0.0, 1.0), SIZE)
    np.testing.assert_array_equal(beyond, image)  # clamped


def test_a_mark_is_white() -> None:
    vertices, faces = mean_face("narrow")
    nose = vertices[vertices[:, 2].argmax()]
    zeros = np.zeros(len(vertices))
    plain = viz.heat_map(vertices, faces, zeros, (0.0, 1.0), SIZE)
    marked = viz.heat_map(vertices, faces, zeros, (0.0, 1.0), SIZE, mark=nose)
    changed = np.abs(marked.astype(int) - plain).sum(axis=2) > 60
    assert 1 <= changed.sum() <= 40  # a ball of 4 mm on a face of 200 mm and 120 pixels
    assert marked[changed].mean() > 150


def test_what_does_not_fit_is_refused() -> None:
    vertices, faces = mean_face("narrow")
    with pytest.raises(ValueError, match="limits"):
        viz.heat_map(vertices, faces, np.zeros(len(vertices)), (1.0, 1.0), SIZE)
    with pytest.raises(ValueError, match="values"):
        viz.heat_map(vertices, faces, np.zeros(3), (0.0, 1.0), SIZE)


def test_a_sheet_has_a_panel_for_each_image(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")
    panel = np.full((50, 50, 3), 200, np.uint8)
    path = viz.heat_sheet([panel] * 3, ["a", "b", "c"], tmp_path / "sheet.png", (0.0, 2.0), "mm")
    sheet = np.asarray(pillow.open(path))
    row = (sheet[len(sheet) // 2] == 200).all(axis=1)
    assert np.count_nonzero(np.diff(row.astype(int)) == 1) == 3
    with pytest.raises(ValueError, match="as many"):
        viz.heat_sheet([panel], [], tmp_path / "x.png", (0.0, 1.0), "mm")


@pytest.mark.slow
def test_figures_draw_errors_and_attention(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from mini_corpus import write_mini_corpus

    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "scripts"))
    import figures

    corpus = write_mini_corpus(tmp_path / "corpus")
    figures.main(
        ["--data", str(corpus), "--out", str(tmp_path / "out"), "--only", "errors", "attention"]
    )
    for name in ("errors", "attention"):
        content = (tmp_path / "out" / f"{name}.png").read_bytes()
        assert content.startswith(b"\x89PNG")
        assert len(content) > 5000
    sys.modules.pop("figures")
