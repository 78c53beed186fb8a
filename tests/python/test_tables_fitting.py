"""FaceTalk's Table 4: what is fitted, and how codes are judged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_corpus_codes import corpus, head  # noqa: F401

from freetalk.data import open_dataset
from freetalk.tables import fitting


def test_autocorrelation_tells_noise_from_motion() -> None:
    rng, time = np.random.default_rng(0), np.arange(400)[:, None]
    smooth = np.sin(2 * np.pi * time / 100 + np.arange(3))
    found = fitting.autocorrelation(smooth)
    assert found[0] == pytest.approx(1) and found[1] > 0.98
    assert found[5] == pytest.approx(np.cos(2 * np.pi * 5 / 100), abs=0.03)
    # White noise is uncorrelated within two of its deviations, 1 / sqrt(1200).
    assert abs(fitting.autocorrelation(rng.normal(size=(400, 3)))[1]) < 0.06


@pytest.mark.slow
def test_table_is_made(corpus: Path, tmp_path: Path) -> None:  # noqa: F811
    model = head()
    model.save_pretrained(tmp_path / "head")
    arguments = ["--data", str(corpus), "--head", str(tmp_path / "head"), "--size", "tiny"]
    assert fitting.main([*arguments, "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out/facetalk_4.json").read_text())
    rows = result["rows"]
    assert len(rows) == 5 and all(row["mae"] <= row["rmse"] for row in rows.values())
    still = rows["Adam [Eq. 16-18], temporal loss"]
    assert still["surface_mm"] > 0 and (tmp_path / "out/facetalk_4.png").is_file()
    assert "| Gauss-Newton, temporal loss |" in (tmp_path / "out/facetalk_4.md").read_text()


def test_a_corpus_without_captured_takes_is_refused(corpus: Path, tmp_path: Path) -> None:  # noqa: F811
    data = open_dataset(corpus)
    others = data.select([s for s in data.sequences() if s.source != "facegood"])
    with pytest.raises(ValueError, match="no captured take"):
        fitting.FittingTask(head(), others, 4, 50, 0.5)
