"""Short animations for tests of the page."""

from __future__ import annotations

import numpy as np

import freetalk as ft
from freetalk.corpus.assets import load_face_model, mean_face

RATE_HZ = 16000


def speaking(
    num_frames: int = 12, fps: float = 25.0, *, strength: float = 0.6, shape: str = "jawOpen"
) -> ft.Animation:
    """The mean face making one movement of a shape and back, with a tone of the same length."""
    vertices, faces = mean_face("face")
    model = load_face_model()
    field = model.expression_basis[model.index(shape), : len(vertices)]
    amount = strength * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(num_frames) / num_frames))
    time = np.arange(round(num_frames / fps * RATE_HZ)) / RATE_HZ
    tone = (0.3 * np.sin(2 * np.pi * 220 * time)).astype(np.float32)
    upright = {"scale": 1.0, "rotation": np.eye(3).tolist(), "translation": [0.0, 0.0, 0.0]}
    return ft.Animation(
        ft.Mesh(vertices, faces.tolist(), name="face"),
        (amount[:, None, None] * field).astype(np.float32),
        fps=fps,
        audio=ft.Audio(tone, RATE_HZ),
        metadata={"alignment": {"to_canonical": upright}, "options": {"emotion": "happy"}},
    )
