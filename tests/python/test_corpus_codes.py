"""Codes of a parametric head for the frames of a corpus."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from mini_corpus import write_mini_corpus
from test_head import tiny
from test_head_fit import ball

from freetalk.cli import main
from freetalk.corpus.heads import head_model
from freetalk.data import open_dataset
from freetalk.head import ParametricHead, content_hash


@pytest.fixture
def corpus(tmp_path: Path) -> Path:
    folder = write_mini_corpus(tmp_path / "corpus")
    manifest = json.loads((folder / "manifest.json").read_text())
    names = manifest["expressions"]  # as the built-in face has them
    manifest["expressions"] = [n + "_L" if n in ("browInnerUp", "cheekPuff") else n for n in names]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def head(**more: object) -> ParametricHead:
    rig = head_model()
    names = list(rig.expression_names)
    model = tiny(
        direction="both", num_weights=len(names), expressions=names, num_coefficients=100, **more
    )
    model.load_state_dict({"canonical_weights": torch.from_numpy(rig.canonical_weights)}, False)
    return model.eval()


def test_frames_get_the_codes_of_their_weights(corpus: Path, tmp_path: Path) -> None:
    model = head()
    model.save_pretrained(tmp_path / "head")
    common = ["corpus", "codes", "--head", str(tmp_path / "head"), "--data", str(corpus)]
    assert main([*common, "--no-fit"]) == 0
    data = open_dataset(corpus)
    assert data.head_codes().head == content_hash(model)
    names = list(model.options.expressions)
    for sequence in data.sequences():
        weights = np.zeros((sequence.num_frames, len(names)), np.float32)
        weights[:, [names.index(name) for name in data.expressions]] = data.weights(sequence, 0)
        with torch.no_grad():
            wanted = model.expression_code(torch.from_numpy(weights)).numpy()
        assert np.allclose(data.codes(sequence, 0), wanted, atol=1e-6)


def test_captured_frames_are_fitted(
    corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = head()
    model.save_pretrained(tmp_path / "head")
    common = ["corpus", "codes", "--head", str(tmp_path / "head"), "--data", str(corpus)]
    assert main([*common, "--no-fit"]) == 0
    before = {s.id: open_dataset(corpus).codes(s, 0) for s in open_dataset(corpus).sequences()}
    assert main(common) == 0
    assert "captured frames" in capsys.readouterr().out
    data = open_dataset(corpus)
    changed = {
        s.source for s in data.sequences() if not np.allclose(data.codes(s, 0), before[s.id])
    }
    assert changed == {"facegood"}


def test_a_head_is_scored_by_region(
    corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rounded = ball(coefficients=100)
    options = rounded.options
    options.box_min, options.box_max = [-0.4] * 3, [0.4] * 3  # where it was trained to be a ball
    names = list(head_model().expression_names)
    options.num_weights, options.expressions = len(names), names
    model = ParametricHead(options).eval()
    state = {k: v for k, v in rounded.state_dict().items() if k != "canonical_weights"}
    model.load_state_dict(state, strict=False)
    model.save_pretrained(tmp_path / "head")
    common = ["head", "score", "--head", str(tmp_path / "head"), "--data", str(corpus)]
    assert main([*common, "--identities", "1", "--expressions", "1"]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [line[:2] for line in lines] == [
        [kind, region] for kind in ("canonical", "posed") for region in ("face", "lips", "head")
    ]
    assert all(float(line[2]) > 3 for line in lines)  # mm: a ball is no head


def test_a_head_of_other_expressions_is_refused(
    corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny(num_weights=1, expressions=["jawOpen"]).save_pretrained(tmp_path / "head")
    common = ["corpus", "codes", "--head", str(tmp_path / "head"), "--data", str(corpus)]
    assert main(common) == 2
    assert "no codes of this head" in capsys.readouterr().err
    assert not (corpus / "codes.npy").exists()
