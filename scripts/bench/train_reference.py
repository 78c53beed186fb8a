"""ATS and STM as one writes them in plain PyTorch: the peers of scripts/bench/train.py.

Parameters bear freetalk's names, so the same weights load into both.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from freetalk.stm import landmark_adjacency


class PlainAts(nn.Module):
    """``torch.nn.TransformerDecoder`` over motion, with the speech features as its memory."""

    def __init__(self, options: Any) -> None:
        super().__init__()
        o, d = options, options.d_model
        self.options = o
        self.input_proj = nn.Linear(204, d)
        self.memory_proj = nn.Linear(o.audio_dim, d)
        self.output_proj = nn.Linear(d, 204)
        self.target_positions = nn.Parameter(torch.zeros(o.max_frames, d))
        self.memory_positions = nn.Parameter(torch.zeros(o.max_frames, d))
        self.null_audio = nn.Parameter(torch.zeros(o.audio_dim))
        self.null_affect = nn.Parameter(torch.zeros(d))
        self.time_in, self.time_out = nn.Linear(d, d), nn.Linear(d, d)
        self.emotion_embedding = nn.Embedding(len(o.emotions), d)
        self.intensity_embedding = nn.Embedding(o.num_intensities, d)
        self.affect_in, self.affect_out = nn.Linear(2 * d, d), nn.Linear(d, d)
        layer = nn.TransformerDecoderLayer(
            d, o.num_heads, o.ff_dim, o.dropout, o.activation, batch_first=True,
            norm_first=o.norm_first,
        )  # fmt: skip
        self.layers = nn.TransformerDecoder(layer, o.num_layers).layers
        self.norm = nn.LayerNorm(d) if o.norm_first else nn.Identity()

    def forward(self, x: Tensor, step: Tensor, batch: dict[str, Tensor]) -> Tensor:
        """Clean motion (B, T, 204) from noisy; ``batch`` as training draws it."""
        o, frames = self.options, x.shape[1]
        half = o.d_model // 2
        rates = torch.exp(torch.arange(half, device=x.device) * (-math.log(10000.0) / half))
        angles = step[:, None].float() * rates
        time = torch.cat([angles.sin(), angles.cos()], dim=1)
        time = self.time_out(functional.silu(self.time_in(time)))
        level = (batch["intensity"] - 1).clamp(0, o.num_intensities - 1)[:, None]
        levels = torch.arange(o.num_intensities, device=x.device)
        hat = (1 - (level - levels).abs()).clamp_min(0)
        affect = torch.cat(
            [
                batch["emotion"] @ self.emotion_embedding.weight,
                hat @ self.intensity_embedding.weight,
            ],
            dim=1,
        )
        affect = self.affect_out(functional.silu(self.affect_in(affect)))
        affect = torch.where(batch["drop_affect"][:, None], self.null_affect.to(affect), affect)
        audio = torch.where(batch["drop_audio"][:, None, None], self.null_audio, batch["audio"])
        memory = self.memory_proj(audio) + self.memory_positions[:frames]
        z = self.input_proj(x) + self.target_positions[:frames] + (time + affect)[:, None]
        index = torch.arange(frames, device=x.device)
        far = (index[:, None] - index).abs() > o.band_radius
        for layer in self.layers:
            z = layer(z, memory, memory_mask=far, tgt_key_padding_mask=~batch["valid"])
        return self.output_proj(self.norm(z))


class PlainBlock(nn.Module):
    """A DiffusionNet block [Sharp et al. 2022] as the public package writes it."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.diffusion = nn.Module()
        self.diffusion.diffusion_time = nn.Parameter(torch.zeros(width))
        self.gradient_features = nn.Module()
        self.gradient_features.A_re = nn.Linear(width, width, bias=False)
        self.gradient_features.A_im = nn.Linear(width, width, bias=False)
        self.mlp = nn.Module()
        for layer, columns in enumerate((3 * width, width, width)):
            self.mlp.add_module(f"miniMLP_mlp_layer_00{layer}", nn.Linear(columns, width))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, operators: Any) -> Tensor:
        """Features (B, V, C) of the next block."""
        time = self.diffusion.diffusion_time.clamp_min(1e-8)
        basis, mass = operators.evecs, operators.mass
        spectrum = basis.T @ (x * mass[:, None])
        diffused = basis @ (spectrum * torch.exp(-operators.evals[:, None] * time))
        batch, vertices, width = diffused.shape
        flat = diffused.float().permute(1, 0, 2).reshape(vertices, -1)
        with torch.autocast(x.device.type, enabled=False):
            gradients = torch.sparse.mm(operators.gradients.to_sparse_csr(), flat)
        gx, gy = gradients.view(2, vertices, batch, width).transpose(1, 2)
        re, im = self.gradient_features.A_re, self.gradient_features.A_im
        features = torch.tanh(gx * (re(gx) - im(gy)) + gy * (re(gy) + im(gx)))
        y = torch.cat([x, diffused, features], dim=-1)
        layers = list(self.mlp.children())
        y = layers[0](y)
        for layer in layers[1:]:
            y = layer(self.dropout(functional.relu(y)))
        return x + y


class PlainDiffusionNet(nn.Module):
    """Blocks between two linear layers."""

    def __init__(self, columns: int, out: int, width: int, blocks: int, dropout: float) -> None:
        super().__init__()
        self.first_lin, self.last_lin = nn.Linear(columns, width), nn.Linear(width, out)
        self.num_blocks = blocks
        for index in range(blocks):
            self.add_module(f"block_{index}", PlainBlock(width, dropout))

    def forward(self, x: Tensor, operators: Any) -> Tensor:
        """(B, V, out) from (B, V, columns)."""
        x = self.first_lin(x)
        for index in range(self.num_blocks):
            x = self.get_submodule(f"block_{index}")(x, operators)
        return self.last_lin(x)


class PlainStm(nn.Module):
    """DiffusionNet encoder, landmark GCN with cross-attention, DiffusionNet decoder."""

    def __init__(self, options: Any) -> None:
        super().__init__()
        o, d = options, options.attention_dim
        self.options = o
        self.encoder = PlainDiffusionNet(
            6, o.feature_dim, o.encoder_width, o.encoder_blocks, o.dropout
        )
        self.gcn = nn.Module()
        for layer in range(o.gcn_layers):
            columns = o.gcn_hidden if layer else 3
            self.gcn.add_module(f"layer_{layer}", nn.Linear(columns, o.gcn_hidden))
        self.landmark_proj = nn.Linear(o.gcn_hidden + o.index_code_dim, d)
        self.query_proj = nn.Linear(o.feature_dim, d)
        self.key_proj, self.value_proj = nn.Linear(d, d), nn.Linear(d, d)
        self.decoder = PlainDiffusionNet(
            o.feature_dim + 204 + d, 3, o.decoder_width, o.decoder_blocks, o.dropout
        )
        self.index_code = nn.Parameter(torch.zeros(68, o.index_code_dim))
        self.register_buffer("adjacency", landmark_adjacency(), persistent=False)

    def forward(self, positions: Tensor, operators: Any, landmarks: Tensor) -> Tensor:
        """Displacements (T, V, 3) from landmark displacements (T, 68, 3), m."""
        o, frames, vertices = self.options, len(landmarks), len(positions)
        mesh = torch.cat([positions / o.length_scale, operators.normals], dim=1)
        features = self.encoder(mesh[None], operators)[0]
        motion = landmarks / o.displacement_scale
        local = motion
        for index in range(o.gcn_layers):
            local = self.adjacency @ self.gcn.get_submodule(f"layer_{index}")(local)
            local = functional.relu(local) if index + 1 < o.gcn_layers else local
        codes = self.index_code.expand(frames, -1, -1)
        local = self.landmark_proj(torch.cat([local, codes], dim=-1))

        def heads(x: Tensor) -> Tensor:
            return x.unflatten(-1, (o.attention_heads, -1)).transpose(-3, -2)

        attended = functional.scaled_dot_product_attention(
            heads(self.query_proj(features)).expand(frames, -1, -1, -1),
            heads(self.key_proj(local)),
            heads(self.value_proj(local)),
        )
        attended = attended.transpose(1, 2).flatten(-2)
        parts = [
            features.expand(frames, -1, -1),
            motion.flatten(1)[:, None].expand(-1, vertices, -1),
            attended,
        ]
        return self.decoder(torch.cat(parts, dim=-1), operators) * o.displacement_scale
