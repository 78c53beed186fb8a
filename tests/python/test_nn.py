"""DiffusionNet and sparse products against closed forms and autograd."""

from __future__ import annotations

import numpy as np
import torch

from freetalk.geometry import SparseOperator, surface_operators
from freetalk.nn import DiffusionNet, sparse_product


def grid(side: int = 6) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0, 1.5, side), np.linspace(0, 1, side), indexing="ij")
    vertices = np.stack([x, y, 0.1 * np.sin(3 * x + 2 * y)], -1).reshape(-1, 3)
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    lower = np.stack([corner, corner + side, corner + 1], 1)
    upper = np.stack([corner + 1, corner + side, corner + side + 1], 1)
    return vertices, np.concatenate([lower, upper]).astype(np.int32)


def test_sparse_product_passes_gradcheck() -> None:
    torch.manual_seed(0)
    dense = torch.randn(6, 4, dtype=torch.float64) * (torch.rand(6, 4) < 0.5)
    x = torch.randn(2, 4, 3, dtype=torch.float64, requires_grad=True)
    matrix = SparseOperator(dense)
    assert torch.autograd.gradcheck(lambda x: sparse_product(matrix, x), (x,))
    assert torch.autograd.gradgradcheck(lambda x: sparse_product(matrix, x), (x,))


def test_diffusion_net_equals_its_formula_with_dense_operators() -> None:
    """One block written out with dense matrices [Sharp et al. 2022], float64."""
    torch.manual_seed(0)
    operators = surface_operators(*grid(), k=10)
    net = DiffusionNet(in_channels=3, out_channels=2, width=4, num_blocks=1).double()
    p = dict(net.named_parameters())
    with torch.no_grad():
        p["block_0.diffusion.diffusion_time"].copy_(torch.rand(4) * 0.1)
    x = torch.randn(2, 36, 3, dtype=torch.float64)
    phi, lam, mass = operators.evecs, operators.evals, operators.mass
    gradients = operators.gradients.to_dense()

    h = x @ p["first_lin.weight"].T + p["first_lin.bias"]
    decay = torch.exp(-lam[:, None] * p["block_0.diffusion.diffusion_time"])
    diffused = phi @ (decay * (phi.T @ (mass[:, None] * h)))
    gx, gy = (gradients @ diffused).split(36, 1)
    re, im = (p[f"block_0.gradient_features.A_{n}.weight"].T for n in ("re", "im"))
    features = torch.tanh(gx * (gx @ re - gy @ im) + gy * (gy @ re + gx @ im))
    y = torch.cat([h, diffused, features], -1)
    for layer in range(3):
        name = f"block_0.mlp.miniMLP_mlp_layer_00{layer}"
        y = (torch.relu(y) if layer else y) @ p[f"{name}.weight"].T + p[f"{name}.bias"]
    expected = (h + y) @ p["last_lin.weight"].T + p["last_lin.bias"]
    torch.testing.assert_close(net(x, operators), expected, atol=1e-10, rtol=1e-10)


def test_diffusion_net_passes_gradcheck() -> None:
    torch.manual_seed(0)
    operators = surface_operators(*grid(4), k=6)
    net = DiffusionNet(in_channels=2, out_channels=1, width=3, num_blocks=1).double()
    x = torch.randn(1, 16, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: net(x, operators), (x,), atol=1e-6)
