"""Training under bfloat16 autocast: what needs its digits keeps them, so that it follows float32."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from test_nn_diffusion_net import wavy_grid
from torch import Tensor

from freetalk.geometry import surface_operators
from freetalk.nn import DiffusionNet, PoissonNet, face_divergence, integrate_jacobians
from freetalk.stm import Stm

SMALL: dict[str, Any] = {
    "encoder_width": 16,
    "encoder_blocks": 2,
    "feature_dim": 16,
    "decoder_width": 16,
    "decoder_blocks": 2,
    "gcn_hidden": 16,
    "index_code_dim": 16,
    "attention_dim": 16,
    "attention_heads": 2,
    "k_eig": 12,
}
KINDS: list[dict[str, str]] = [
    {},
    {"extractor": "mlp"},
    {"extractor": "poissonnet"},
    {"decoder": "mlp"},
    {"decoder": "njf"},
    {"fusion": "concat"},
    {"fusion": "ca"},
    {"fusion": "ca_concat"},
]


def away_from_zero(model: torch.nn.Module) -> None:
    """Last layers and diffusion times begin at zero, which every precision gets right."""
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if name.endswith("diffusion_time"):
                parameter.uniform_(0, 0.05)
            elif not parameter.any():
                parameter.normal_(0, 0.2)


def relative(a: Tensor, b: Tensor) -> float:
    return float((a.detach().float() - b).norm() / b.norm())


def assert_follows_float32(
    model: torch.nn.Module, predict: Callable[[], Tensor], target: Tensor
) -> None:
    """bfloat16 keeps 8 bits: each product is off by up to 0.4 %, a dozen of them in a row by a few percent."""

    def run() -> tuple[Tensor, Tensor, Tensor]:
        prediction = predict().float()
        loss = (prediction - target).square().mean() / target.square().mean()
        loss.backward()
        gradient = torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])
        model.zero_grad()
        return prediction.detach(), loss.detach(), gradient

    exact, _, gradient = run()
    autocast = torch.autocast("cpu", torch.bfloat16)
    with autocast:
        prediction = predict()
    assert relative(prediction, exact) < 0.05
    losses = []
    optimizer = torch.optim.Adam(model.parameters(), lr=3e-3)
    for step in range(12):
        with autocast:
            prediction = predict().float()
            loss = (prediction - target).square().mean() / target.square().mean()
        loss.backward()
        if step == 0:
            found = torch.cat([p.grad.flatten() for p in model.parameters() if p.grad is not None])
            assert found.isfinite().all()
            assert torch.cosine_similarity(found, gradient, dim=0) > 0.99
        optimizer.step()
        optimizer.zero_grad()
        losses.append(float(loss))
    assert losses[-1] < 0.95 * losses[0]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: "-".join(kind.values()) or "all")
def test_stm_follows_float32(kind: dict[str, str]) -> None:
    torch.manual_seed(0)
    model = Stm(**SMALL, **kind)
    away_from_zero(model)
    vertices, faces = wavy_grid(8, 7)
    operators = surface_operators(vertices, faces, k=12, cache=False).to(torch.float32)
    positions = torch.from_numpy(vertices * model.options.length_scale).float()
    landmarks = 0.002 * torch.randn(3, 68, 3)
    target = 0.002 * torch.randn(3, 56, 3)
    assert_follows_float32(model, lambda: model(positions, operators, landmarks), target)


@pytest.mark.parametrize("method", ["spectral", "implicit_dense"])
def test_diffusion_net_follows_float32(method: str) -> None:
    torch.manual_seed(0)
    net = DiffusionNet(
        in_channels=3, out_channels=2, width=16, num_blocks=2, diffusion_method=method
    )
    away_from_zero(net)
    operators = surface_operators(*wavy_grid(8, 7), k=12, cache=False).to(torch.float32)
    x, target = torch.randn(2, 56, 3), torch.randn(2, 56, 2)
    assert_follows_float32(net, lambda: net(x, operators), target)


def test_poisson_net_follows_float32() -> None:
    torch.manual_seed(0)
    net = PoissonNet(in_channels=3, out_channels=2, width=16, num_blocks=2)
    away_from_zero(net)
    operators = surface_operators(*wavy_grid(8, 7), k=12, cache=False).to(torch.float32)
    x, target = torch.randn(2, 56, 3), torch.randn(2, 56, 2)
    assert_follows_float32(net, lambda: net(x, operators), target)


def test_surface_operations_are_the_same_under_autocast() -> None:
    """Differences of neighbours drown in 8 bits; these run in float32, bit for bit."""
    torch.manual_seed(0)
    operators = surface_operators(*wavy_grid(8, 7), k=12, cache=False).to(torch.float32)
    faces = operators.faces()
    count = len(faces.faces)
    g, jacobians = torch.randn(2, 2 * count, 3), torch.randn(2, count, 3, 3)
    plain = face_divergence(faces, g), integrate_jacobians(faces, jacobians)
    with torch.autocast("cpu", torch.bfloat16):
        under = face_divergence(faces, g), integrate_jacobians(faces, jacobians)
    assert all(torch.equal(a, b) for a, b in zip(plain, under, strict=True))


def test_diffusion_times_stay_as_they_are_and_take_the_gradient_at_the_floor() -> None:
    """A forward pass changes no parameter; at zero the gradient is whole; what has gone below only comes back."""
    torch.manual_seed(0)
    operators = surface_operators(*wavy_grid(5, 4), k=8, cache=False)
    net = DiffusionNet(in_channels=2, out_channels=1, width=6, num_blocks=1).double()
    (time,) = [p for name, p in net.named_parameters() if name.endswith("diffusion_time")]
    x, weight = torch.randn(2, 20, 2).double(), torch.randn(2, 20, 1).double()

    def gradient(value: float) -> Tensor:
        with torch.no_grad():
            time.fill_(value)
        net.zero_grad()
        (net(x, operators) * weight).sum().backward()
        assert torch.equal(time, torch.full_like(time, value))
        assert time.grad is not None
        return time.grad

    floor = gradient(1e-8)
    assert (floor > 0).any() and (floor < 0).any()
    torch.testing.assert_close(gradient(0.0), floor)
    torch.testing.assert_close(gradient(-0.5), floor.clamp_max(0))
