"""DiffusionNet and PoissonNet written out in plain PyTorch, as their papers and packages define them.

Dense or sparse operators, one mesh at a time, no fusion: what the native networks are compared with. Tensors
carry the public packages' names.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional


class PlainMlp(nn.Module):
    """Linear layers with ReLU between, dropout before all but the first."""

    def __init__(self, widths: list[int], dropout: float) -> None:
        super().__init__()
        self.dropout = dropout
        self.names = [f"miniMLP_mlp_layer_{index:03d}" for index in range(len(widths) - 1)]
        for name, (inputs, outputs) in zip(
            self.names, zip(widths, widths[1:], strict=False), strict=True
        ):
            self.add_module(name, nn.Linear(inputs, outputs))

    def forward(self, x: Tensor) -> Tensor:
        for index, name in enumerate(self.names):
            if index > 0:
                x = functional.dropout(torch.relu(x), self.dropout, self.training)
            x = getattr(self, name)(x)
        return x


class PlainDiffusion(nn.Module):
    """Learned heat diffusion, spectral or by one dense implicit step a channel."""

    def __init__(self, width: int, method: str) -> None:
        super().__init__()
        self.method = method
        self.diffusion_time = nn.Parameter(torch.zeros(width))

    def forward(self, x: Tensor, mesh: dict[str, Tensor]) -> Tensor:
        with torch.no_grad():
            self.diffusion_time.clamp_(min=1e-8)
        time, mass = self.diffusion_time, mesh["mass"]
        if self.method == "spectral":
            spectrum = mesh["evecs"].T @ (mass[:, None] * x)
            return mesh["evecs"] @ (torch.exp(-mesh["evals"][:, None] * time) * spectrum)
        systems = time[:, None, None] * mesh["laplacian"].to_dense() + torch.diag(mass)
        right = (mass[:, None] * x).transpose(-1, -2).unsqueeze(-1)
        return torch.linalg.solve(systems, right).squeeze(-1).transpose(-1, -2)


class PlainGradientFeatures(nn.Module):
    """tanh of products of gradients with their rotated, scaled selves."""

    def __init__(self, width: int, rotations: bool) -> None:
        super().__init__()
        self.rotations = rotations
        for name in ("A_re", "A_im") if rotations else ("A",):
            self.add_module(name, nn.Linear(width, width, bias=False))

    def forward(self, gx: Tensor, gy: Tensor) -> Tensor:
        if not self.rotations:
            return torch.tanh(gx * self.A(gx) + gy * self.A(gy))
        real = self.A_re(gx) - self.A_im(gy)
        imaginary = self.A_re(gy) + self.A_im(gx)
        return torch.tanh(gx * real + gy * imaginary)


class PlainBlock(nn.Module):
    """Diffusion, gradient features, MLP, residual."""

    def __init__(self, width: int, hidden: list[int], dropout: float, **kind: Any) -> None:
        super().__init__()
        gradients = kind.get("with_gradient_features", True)
        self.diffusion = PlainDiffusion(width, kind.get("diffusion_method", "spectral"))
        if gradients:
            self.gradient_features = PlainGradientFeatures(
                width, kind.get("with_gradient_rotations", True)
            )
        self.mlp = PlainMlp([(3 if gradients else 2) * width, *hidden, width], dropout)

    def forward(self, x: Tensor, mesh: dict[str, Tensor]) -> Tensor:
        diffused = self.diffusion(x, mesh)
        parts = [x, diffused]
        if hasattr(self, "gradient_features"):
            frames = diffused if diffused.dim() == 3 else diffused[None]
            gx = torch.stack([mesh["grad_x"] @ frame for frame in frames]).view_as(diffused)
            gy = torch.stack([mesh["grad_y"] @ frame for frame in frames]).view_as(diffused)
            parts.append(self.gradient_features(gx, gy))
        return x + self.mlp(torch.cat(parts, -1))


class PlainDiffusionNet(nn.Module):
    """The network of Sharp et al. 2022, x (V, C) or (B, V, C)."""

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        width: int = 128,
        num_blocks: int = 4,
        dropout: float = 0.0,
        mlp_hidden: list[int] | None = None,
        outputs_at: str = "vertices",
        **kind: Any,
    ) -> None:
        super().__init__()
        self.outputs_at = outputs_at
        self.num_blocks = num_blocks
        self.first_lin = nn.Linear(in_channels, width)
        self.last_lin = nn.Linear(width, out_channels)
        for index in range(num_blocks):
            block = PlainBlock(width, mlp_hidden or [width, width], dropout, **kind)
            self.add_module(f"block_{index}", block)

    def forward(self, x: Tensor, mesh: dict[str, Tensor]) -> Tensor:
        x = self.first_lin(x)
        for index in range(self.num_blocks):
            x = getattr(self, f"block_{index}")(x, mesh)
        x = self.last_lin(x)
        if self.outputs_at in ("edges", "faces"):
            return x[..., mesh[self.outputs_at], :].mean(-2)
        if self.outputs_at == "global_mean":
            mass = mesh["mass"][:, None]
            return (x * mass).sum(-2, keepdim=True) / mass.sum()
        return x


def plain_mesh(operators: Any, dtype: torch.dtype = torch.float64) -> dict[str, Tensor]:
    """Native operators as the plain networks take them (gradients sparse, the rest dense)."""
    count = len(operators.mass)
    gradients = operators.gradients.to_sparse_csr().to_sparse_coo()
    rows, columns = gradients.indices()
    upper = rows < count

    def half(keep: Tensor, shift: int) -> Tensor:
        indices = torch.stack([rows[keep] - shift, columns[keep]])
        values = gradients.values()[keep].to(dtype)
        return torch.sparse_coo_tensor(indices, values, (count, count)).coalesce().to_sparse_csr()

    return {
        "mass": operators.mass.to(dtype),
        "evals": operators.evals.to(dtype),
        "evecs": operators.evecs.to(dtype),
        "grad_x": half(upper, 0),
        "grad_y": half(~upper, count),
    }
