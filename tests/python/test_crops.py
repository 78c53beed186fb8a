"""Rendered mouths and what is told of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from freetalk.corpus import load_face_model, mean_face
from freetalk.evaluate.crops import (
    clip_score,
    dct_features,
    mouth_frames,
    network_features,
)
from freetalk.evaluate.generated import features_of, frechet_distance
from freetalk.viz import Sequence


def shown(**weights: float) -> Sequence:
    """A face at rest and under expressions, a frame of each."""
    model = load_face_model()
    vertices, faces = mean_face("narrow")
    moved = sum(w * model.expression_basis[model.index(n)] for n, w in weights.items())
    motion = np.stack([np.zeros_like(vertices), np.asarray(moved)[: len(vertices)]])
    return Sequence(vertices, faces.astype(np.int64), motion.astype(np.float32), 25.0, located=True)


@pytest.mark.slow
def test_crops_show_the_mouth_and_nothing_above() -> None:
    rest, opened = mouth_frames(shown(jawOpen=0.6)).astype(int)
    assert rest.shape == (64, 64, 3) and (rest[..., 0] == rest[..., 1]).all()
    assert np.abs(opened - rest).mean() > 5
    still, raised = mouth_frames(shown(browInnerUp_L=1.0, browInnerUp_R=1.0)).astype(int)
    # Brows lie outside; skin that they pull at reaches down a little.
    assert np.abs(raised - still).mean() < 0.2 * np.abs(opened - rest).mean()


@pytest.mark.slow
def test_distance_grows_with_the_difference_of_mouths() -> None:
    rng = np.random.default_rng(0)

    def features(weights: np.ndarray) -> np.ndarray:
        frames = [mouth_frames(shown(jawOpen=float(w)))[1] for w in weights]
        return features_of(frames, dct_features)

    usual = features(rng.uniform(0.1, 0.4, 6))
    near, far = features(rng.uniform(0.1, 0.4, 6)), features(rng.uniform(0.6, 0.9, 6))
    assert usual.shape == (6, 63)
    assert frechet_distance(near, usual) < 0.3 * frechet_distance(far, usual)


class _Mean(torch.nn.Module):
    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        return pictures.float().mean(dim=(2, 3))


def test_a_users_network_gives_the_features(tmp_path: Path) -> None:
    torch.jit.script(_Mean()).save(str(tmp_path / "net.pt"))
    pictures = list(np.random.default_rng(0).integers(0, 255, (3, 8, 8, 3), dtype=np.uint8))
    found = network_features(tmp_path / "net.pt")(pictures)
    assert np.allclose(found, np.stack(pictures).mean(axis=(1, 2)), atol=1e-3)
    (tmp_path / "bad.pt").write_text("x")
    with pytest.raises(ValueError, match="is no TorchScript network"):
        network_features(tmp_path / "bad.pt")


def test_a_users_score_is_found_by_name() -> None:
    name, score = clip_score("length=test_crops:frames_of")
    assert name == "length" and score(np.zeros((7, 2, 2, 3), np.uint8), 25.0) == 7
    for wrong in ("length", "length=module", "x=test_crops:none"):
        with pytest.raises(ValueError, match="--score"):
            clip_score(wrong)


def frames_of(frames: np.ndarray, fps: float) -> float:
    return float(len(frames))
