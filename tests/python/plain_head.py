"""A parametric head written out in plain PyTorch, every local network everywhere: what the native one is compared with.

Tensors carry the public NPHM code's names.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class PlainEnsembledLinear(nn.Module):
    def __init__(self, members: int, pairs: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.pairs = pairs
        self.weight = nn.Parameter(torch.zeros(members - pairs, outputs, inputs))
        self.bias = nn.Parameter(torch.zeros(members - pairs, outputs))

    def forward(self, x: Tensor) -> Tensor:
        """(members, rows, inputs) to (members, rows, outputs)."""

        def shared(tensor: Tensor) -> Tensor:
            return torch.cat(
                [tensor[: self.pairs].repeat_interleave(2, dim=0), tensor[self.pairs :]]
            )

        return x @ shared(self.weight).transpose(1, 2) + shared(self.bias)[:, None]


class PlainFieldMlp(nn.Module):
    """softplus(100) layers over [point | code], which joins again in the middle."""

    def __init__(
        self, inputs: int, hidden: int, layers: int, outputs: int, members: tuple[int, int] | None
    ) -> None:
        super().__init__()
        self.layers, self.skip = layers, layers // 2
        widths = [inputs] + [hidden] * layers + [outputs]
        for index in range(layers + 1):
            out = widths[index + 1] - (inputs if index + 1 == self.skip else 0)
            layer: nn.Module = (
                PlainEnsembledLinear(*members, widths[index], out)
                if members
                else nn.Linear(widths[index], out)
            )
            self.add_module(f"lin{index}", layer)

    def forward(self, inputs: Tensor) -> Tensor:
        x = inputs
        for index in range(self.layers + 1):
            if index == self.skip:
                x = torch.cat([x, inputs], -1) / 2**0.5
            x = getattr(self, f"lin{index}")(x)
            if index < self.layers:
                x = functional.softplus(x, beta=100)
        return x


class PlainIdentity(nn.Module):
    def __init__(
        self,
        global_dim: int,
        local_dim: int,
        anchors: int,
        pairs: int,
        hidden: int,
        layers: int,
        anchor_hidden: int,
        eps: float = 1e-6,
    ) -> None:
        super().__init__()
        self.global_dim, self.local_dim, self.pairs, self.eps = global_dim, local_dim, pairs, eps
        self.ensembled_deep_sdf = PlainFieldMlp(
            3 + global_dim + local_dim, hidden, layers, 1, (anchors + 1, pairs)
        )
        self.mlp_pos = nn.Sequential(
            nn.Linear(global_dim, anchor_hidden),
            nn.ReLU(),
            nn.Linear(anchor_hidden, anchor_hidden),
            nn.ReLU(),
            nn.Linear(anchor_hidden, 3 * anchors),
        )
        self.register_buffer("anchors", torch.zeros(anchors, 3))
        self.anchors: Tensor

    def predict_anchors(self, z: Tensor) -> Tensor:
        moved: Tensor = self.mlp_pos(z[:, : self.global_dim]).unflatten(1, (-1, 3))
        return moved + self.anchors

    def forward(self, points: Tensor, z: Tensor, outside: bool = False) -> Tensor:
        batch, count = points.shape[:2]
        anchors = self.predict_anchors(z)
        origins = torch.cat([anchors, torch.zeros(batch, 1, 3)], 1)
        members = origins.shape[1]
        local = points[:, :, None] - origins[:, None]  # (B, N, K, 3)
        flip = torch.ones(members, 3)
        flip[1 : 2 * self.pairs : 2, 0] = -1
        codes = torch.cat(
            [
                z[:, None, : self.global_dim].expand(batch, members, self.global_dim),
                z[:, self.global_dim :].unflatten(1, (members, self.local_dim)),
            ],
            2,
        )
        inputs = torch.cat([local * flip, codes[:, None].expand(batch, count, members, -1)], 3)
        values = self.ensembled_deep_sdf(inputs.permute(2, 0, 1, 3).flatten(1, 2))
        values = values.view(members, batch, count).permute(1, 2, 0)
        if outside:
            values = torch.cat([values[..., :-1], torch.ones(batch, count, 1)], 2)
        exponent = -((local[:, :, :-1].norm(dim=3) + 1e-5) ** 2) / 0.01
        weights = torch.cat([exponent, torch.full((batch, count, 1), -20.0)], 2).exp()
        weights = weights / (weights.sum(2, keepdim=True) + self.eps)
        return (weights * values).sum(2)


class PlainDeformation(nn.Module):
    def __init__(self, identity: int, code: int, expression: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.compressor = nn.Sequential(nn.Linear(identity, code))
        self.defDeepSDF = PlainFieldMlp(3 + code + expression, hidden, layers, 3, None)

    def forward(self, points: Tensor, z: Tensor, anchors: Tensor, expression: Tensor) -> Tensor:
        code = self.compressor(torch.cat([z, anchors.flatten(1)], 1))
        code = torch.cat([code, expression], 1)[:, None].expand(-1, points.shape[1], -1)
        offsets: Tensor = self.defDeepSDF(torch.cat([points, code], 2))
        return offsets


class PlainHead(nn.Module):
    """The published sizes, or `hidden` ones; posed to canonical."""

    def __init__(
        self,
        global_dim: int = 64,
        local_dim: int = 32,
        identity_hidden: int = 200,
        expression_dim: int = 200,
        deformation_hidden: int = 512,
    ) -> None:
        super().__init__()
        self.identity = PlainIdentity(global_dim, local_dim, 39, 16, identity_hidden, 4, 256)
        self.deformation_backward = PlainDeformation(
            global_dim + 40 * local_dim + 117, 32, expression_dim, deformation_hidden, 6
        )

    def forward(self, points: Tensor, z: Tensor, expression: Tensor) -> Tensor:
        anchors = self.identity.predict_anchors(z)
        moved = points + self.deformation_backward(points, z, anchors, expression)
        distance: Tensor = self.identity(moved, z)
        return distance


def randomize(head: nn.Module, seed: int = 0) -> None:
    """Weights that keep fields of the size of a head's, and anchors spread over a face."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, tensor in head.state_dict().items():
            if name.endswith("anchors"):
                tensor.copy_(torch.rand(tensor.shape, generator=generator) * 0.6 - 0.3)
            elif name.endswith(("weight", "bias")):
                bound = (tensor.shape[-1] if tensor.dim() > 1 else 100) ** -0.5
                tensor.uniform_(-bound, bound, generator=generator)
