"""STM's attention as it can be looked at is the one that its decoder uses."""

from __future__ import annotations

import math

import pytest
import torch

from freetalk.geometry import SurfaceOperators, surface_operators
from freetalk.stm import Stm

SMALL = {
    **dict.fromkeys(("encoder_width", "decoder_width", "feature_dim"), 16),
    **dict.fromkeys(("gcn_hidden", "index_code_dim", "attention_dim"), 16),
    "encoder_blocks": 1,
    "decoder_blocks": 1,
    "attention_heads": 2,
    "k_eig": 8,
}


@pytest.fixture(scope="module")
def sheet() -> tuple[torch.Tensor, SurfaceOperators]:
    rows, columns = 6, 5
    grid = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).double() * 0.02
    points = torch.cat([grid, grid[:, :1] ** 2], dim=1)
    faces = [
        [a, a + 1, a + columns] if turn == 0 else [a + 1, a + columns + 1, a + columns]
        for row in range(rows - 1)
        for a in range(row * columns, row * columns + columns - 1)
        for turn in (0, 1)
    ]
    operators = surface_operators((points / 0.1).numpy(), torch.tensor(faces).numpy(), k=8)
    return points.float(), operators.to(dtype=torch.float32)


def test_weights_are_the_softmax_of_the_printed_formula(
    sheet: tuple[torch.Tensor, SurfaceOperators],
) -> None:
    torch.manual_seed(0)
    model = Stm(fusion="ca", **SMALL).eval()
    landmarks = 1e-3 * torch.randn(3, 68, 3)
    with torch.no_grad():
        mesh = model.encode(*sheet)
        weights = model.attention(mesh, landmarks)
        state = model.state_dict()

        def linear(name: str, x: torch.Tensor) -> torch.Tensor:
            return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]

        code = state["index_code"].expand(3, -1, -1)
        motion = landmarks / model.options.displacement_scale
        keys = linear("key_proj", linear("landmark_proj", torch.cat([motion, code], dim=-1)))
        keys = keys.unflatten(-1, (2, 8))  # (T, 68, heads, d_head)
        logits = torch.einsum("hvd,tjhd->thvj", mesh.queries, keys) / math.sqrt(8)
    # Sums of 8 products of numbers near one, in another order.
    torch.testing.assert_close(weights, logits.softmax(dim=-1), rtol=1e-4, atol=1e-6)
    assert weights.shape == (3, 2, 30, 68)


def test_attention_depends_on_the_frame_alone(
    sheet: tuple[torch.Tensor, SurfaceOperators],
) -> None:
    torch.manual_seed(0)
    model = Stm(**SMALL).eval()
    landmarks = 1e-3 * torch.randn(4, 68, 3)
    with torch.no_grad():
        mesh = model.encode(*sheet)
        whole, one = model.attention(mesh, landmarks), model.attention(mesh, landmarks[2:3])
    torch.testing.assert_close(whole[2:3], one)
    assert not torch.allclose(whole[0], whole[1])


def test_a_network_without_attention_says_so(
    sheet: tuple[torch.Tensor, SurfaceOperators],
) -> None:
    model = Stm(fusion="concat", **SMALL).eval()
    with torch.no_grad():
        mesh = model.encode(*sheet)
    with pytest.raises(ValueError, match="concat"):
        model.attention(mesh, torch.zeros(1, 68, 3))
