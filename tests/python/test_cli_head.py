"""``freetalk head``: what it writes, and one sentence for what it refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_head import tiny
from test_head_fit import ball

import freetalk
from freetalk.cli import main
from freetalk.head import ParametricHead, load_codes


def run(*arguments: str | Path) -> int:
    return main(["head", *(str(argument) for argument in arguments)])


@pytest.mark.slow
def test_a_sampled_head_is_fitted_and_extracted_again(tmp_path: Path) -> None:
    trained = ball(coefficients=4)
    options = trained.options
    options.box_min, options.box_max = [-0.4] * 3, [0.4] * 3  # where it was trained to be a ball
    model = ParametricHead(options).eval()
    model.load_state_dict(trained.state_dict())
    model.save_pretrained(tmp_path / "head")
    first = tmp_path / "first.ply"
    size = ("--resolution", "128")
    assert run("sample", "--head", tmp_path / "head", "--seed", "3", "--out", first, *size) == 0
    codes = tmp_path / "codes.npz"
    about = ("--head", tmp_path / "head", "--out", codes, "--points", "300", "--fps", "25")
    assert run("fit", first, *about) == 0
    assert load_codes(codes, model).z_exp.shape == (1, 5)
    again = tmp_path / "again.ply"
    assert run("extract", "--head", tmp_path / "head", "--codes", codes, "--out", again, *size) == 0
    a, b = (np.asarray(freetalk.load_mesh(path).vertices) for path in (first, again))
    assert np.abs(a.max(0) - b.max(0)).max() < 5e-3  # metres, of 65 mm: the toy is rough


def test_what_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tiny().save_pretrained(tmp_path / "head")
    assert run("sample", "--head", tmp_path / "none", "--out", tmp_path / "a.ply") == 2
    assert "does not exist" in capsys.readouterr().err
    assert run("sample", "--head", tmp_path / "head", "--out", tmp_path / "a.txt") == 2
    assert ".obj or .ply" in capsys.readouterr().err
    (tmp_path / "codes.npz").write_text("nothing")
    with_codes = ("--codes", tmp_path / "codes.npz", "--out", tmp_path / "a.ply")
    assert run("extract", "--head", tmp_path / "head", *with_codes) == 2
    assert "codes.npz" in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))
