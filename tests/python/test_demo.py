"""The demo, on a short piece of its speech."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from test_talker import write_weights

import freetalk as ft
from freetalk.corpus import assets

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "demo.py"


@pytest.fixture
def demo() -> ModuleType:
    spec = importlib.util.spec_from_file_location("freetalk_demo", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_demo_face_is_a_real_mesh_with_an_identity(demo: ModuleType, tmp_path: Path) -> None:
    mesh = ft.load_mesh(demo.write_face(tmp_path / "face.obj"))
    mean, _ = assets.mean_face("face")
    assert mesh.vertices.shape == mean.shape
    assert len(mesh.polygons) < len(mesh.faces)  # quads are kept
    distance = np.linalg.norm(mesh.vertices - mean, axis=1)
    assert 0.001 < distance.mean() < 0.03  # metres: another person, not another species


def test_demo_writes_what_it_promises(
    demo: ModuleType,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    speech = ft.load_audio(assets.speech_clip())
    short = tmp_path / "short.wav"
    ft.audio.save_wav(short, ft.Audio(np.asarray(speech.samples)[:16000], 16000))
    monkeypatch.setattr(assets, "speech_clip", lambda: short)
    monkeypatch.setattr(demo, "PERFORMANCES", (("neutral", 1.0), ("happy", 3.0)))
    out = tmp_path / "out"
    monkeypatch.setenv("FREETALK_CACHE", str(tmp_path / "cache"))
    weights = tmp_path / "weights"
    weights.mkdir()
    write_weights(weights)
    words = ["--out", str(out), "--size", "64", "--pretrained", str(weights)]
    monkeypatch.setattr(sys, "argv", ["demo", *words])
    demo.main()
    names = {entry.name for entry in out.iterdir()}
    kinds = ("glb", "mp4", "speech.wav")  # the sound lies beside a .glb too
    expected = {f"{emotion}.{kind}" for emotion in ("neutral", "happy") for kind in kinds}
    assert names == expected | {"face.obj", "contact_sheet.png"}
    printed = capsys.readouterr().out
    assert str(out.resolve()) in printed and "motion" in printed
