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
from freetalk.corpus.heads import PosedHead, head_model, held_out_identities
from freetalk.data import open_dataset
from freetalk.evaluate.heads import _by_region, seen_from
from freetalk.geometry import SurfaceTree
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
    common += ["--identities", "1", "--expressions", "1", "--points", "5000", "--one-view"]
    assert main(common) == 0
    lines = capsys.readouterr().out.replace("one view", "one_view").splitlines()[1:]
    rows = [line.split() for line in lines]
    kinds, regions = ("canonical", "posed", "one_view"), ("face", "lips", "head")
    assert [row[:2] for row in rows] == [[kind, region] for kind in kinds for region in regions]
    assert all(float(row[2]) > 3 for row in rows[:6])  # mm: a ball is no head


def _true_head() -> PosedHead:
    rig = head_model()
    return PosedHead(rig, held_out_identities()[0], np.zeros(len(rig.expression_names), np.float32))


def test_what_nobody_sees_does_not_count() -> None:
    """The true head's own backs of eyes and inside of the mouth are no errors."""
    truth = _true_head()
    mesh = (1e3 * truth.vertices, truth.faces)
    for region, scores in _by_region(head_model(), truth, mesh, 30_000).items():
        assert scores.chamfer_l1 < 1.1 * scores.sampling_floor, region
        assert scores.f_scores[5.0] > 0.999, region


def test_a_scan_of_one_side_is_near_the_surface_and_has_no_other() -> None:
    truth = _true_head()
    scan = seen_from(truth, 30.0, np.random.default_rng(2))
    assert scan.shape == (2500, 3)
    off = SurfaceTree(truth.vertices, truth.faces[truth.is_outer()]).nearest(scan)[1]
    assert 5e-5 < off.mean() < 4e-4
    toward = scan @ [np.sin(np.radians(30)), 0.0, np.cos(np.radians(30))]
    height = np.floor(scan[:, 1] / 0.02)
    for row in np.unique(
        height
    ):  # nothing of the back: its points would lie 10 cm behind those of the front
        own = toward[height == row]
        assert own.max() - own.min() < 0.16


def test_a_head_of_other_expressions_is_refused(
    corpus: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny(num_weights=1, expressions=["jawOpen"]).save_pretrained(tmp_path / "head")
    common = ["corpus", "codes", "--head", str(tmp_path / "head"), "--data", str(corpus)]
    assert main(common) == 2
    assert "no codes of this head" in capsys.readouterr().err
    assert not (corpus / "codes.npy").exists()
