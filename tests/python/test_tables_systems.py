"""FaceTalk's Table 1: systems are scored on rendered mouths and on lips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mini_corpus import write_mini_corpus

from freetalk.data import open_dataset
from freetalk.evaluate.crops import dct_features
from freetalk.tables.systems import SystemsTask, text


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> SystemsTask:
    corpus = open_dataset(write_mini_corpus(tmp_path_factory.mktemp("systems") / "corpus"))
    scores = {"frames": lambda frames, fps: float(len(frames))}
    return SystemsTask(corpus, 2, 9, dct_features, scores=scores)


@pytest.mark.slow
def test_the_truth_has_no_error_and_a_still_face_has(task: SystemsTask) -> None:
    truth, still = task.judged(task.truth), task.judged(task.still)
    assert truth["fid"]["mean"] == pytest.approx(0, abs=1e-9) and truth["lve"]["mean"] == 0
    assert truth["frames"]["mean"] == 8  # 9 at 30 fps, at 25
    assert still["fid"]["mean"] > 1e-4 and still["lve"]["mean"] > 0 and "opening" not in still
    values = list(still["lve"]["per_sequence"].values())
    assert len(values) == 2 and still["lve"]["mean"] == pytest.approx(np.mean(values))
    said = dict.fromkeys(("size", "command", "commit", "data_fingerprint", "about", "drawn"), "-")
    moving = {"mean": 0.5, "low": 0.25, "high": 0.75}
    table = text({**said, "rows": {"half": {**truth, "opening": moving}, "still face": still}})
    assert "| still face | " in table and "| – |" in table and "| FID | KID |" in table
    assert "| 0.500 [0.250, 0.750] |" in table


@pytest.mark.slow
def test_predictions_are_read(task: SystemsTask, tmp_path: Path) -> None:
    for clip in task.clips:
        np.save(tmp_path / f"{clip.id}.npy", 0.5 * task.truth(clip))
    half = task.judged(task.predicted(tmp_path))
    assert half["lve"]["mean"] == pytest.approx(
        0.25 * task.judged(task.still)["lve"]["mean"], rel=1e-3
    )
    np.save(tmp_path / f"{task.clips[0].id}.npy", np.zeros((4, 5, 3)))
    with pytest.raises(ValueError, match="expected"):
        task.predicted(tmp_path)(task.clips[0])
