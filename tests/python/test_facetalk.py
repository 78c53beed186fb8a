"""The FaceTalk denoiser against a plain re-statement of the paper, under autocast and as a torch module."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import pytest
import torch
from test_autocast import assert_follows_float32
from torch import Tensor, nn
from torch.nn import functional

from freetalk.facetalk import (
    CodeStream,
    FaceTalk,
    GenerateOptions,
    codes_from_landmarks,
    generate,
)

SMALL: dict[str, Any] = {
    "code_dim": 6,
    "audio_dim": 5,
    "d_model": 16,
    "num_layers": 2,
    "num_heads": 2,
    "ff_dim": 24,
    "dropout": 0.0,
    "window": 4,
    "max_frames": 12,
}
VARIANTS: list[dict[str, Any]] = [
    {},
    {"film_form": "plain"},
    {"time_condition": "scale_shift"},
    {"time_condition": "squeeze_excite"},
    {"time_condition": "dot_product"},
    {"time_condition": "input"},
    {"norm_first": False, "activation": "relu"},
    {"positions": "learned", "time_layers": 2},
    {"align_audio": False},
    {"window": 0},
]


class PlainPlace(nn.Module):
    """What the step does to the output y of a sub-layer that is added to x [FaceTalk Fig. 10]."""

    def __init__(self, d: int, condition: str, form: str) -> None:
        super().__init__()
        self.condition, self.form = condition, form
        if condition == "squeeze_excite":
            self.squeeze, self.linear = nn.Linear(d, d // 4), nn.Linear(d // 4, d)
        else:
            self.linear = nn.Linear(d, 2 * d)
        if condition == "dot_product":
            self.query = nn.Linear(d, d)

    def forward(self, x: Tensor, y: Tensor, code: Tensor) -> Tensor:
        if self.condition == "squeeze_excite":
            return x + y * torch.sigmoid(self.linear(torch.relu(self.squeeze(code))))[:, None]
        told = self.linear(functional.mish(code) if self.condition == "film" else code)
        first, second = told[:, None].chunk(2, -1)
        if self.condition == "dot_product":
            keys = torch.stack([y, first.expand_as(y)], -2)  # of each frame: itself, the code
            values = torch.stack([y, second.expand_as(y)], -2)
            logits = (keys * self.query(y)[..., None, :]).sum(-1) / math.sqrt(y.shape[-1])
            return x + (logits.softmax(-1)[..., None] * values).sum(-2)
        if self.condition == "scale_shift":
            return (x + y) * (1 + first) + second
        if self.form == "plain":
            return (x + y) * first + second
        return x + y * (1 + first) + second


class PlainAttention(nn.Module):
    """Causal multi-head attention within a window, positions as complex rotations."""

    def __init__(self, d: int, heads: int, window: int, rotary: bool) -> None:
        super().__init__()
        self.heads, self.window, self.rotary = heads, window, rotary
        self.in_proj_weight = nn.Parameter(torch.empty(3 * d, d))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * d))
        self.out_proj = nn.Linear(d, d)

    def forward(self, x: Tensor) -> Tensor:
        batch, frames, d = x.shape
        q, k, v = (
            part.view(batch, frames, self.heads, -1).transpose(1, 2)
            for part in functional.linear(x, self.in_proj_weight, self.in_proj_bias).chunk(3, -1)
        )
        if self.rotary:
            q, k = self._turned(q), self._turned(k)
        i, j = torch.arange(frames)[:, None], torch.arange(frames)[None]
        allowed = (j <= i) & ((i - j < self.window) if self.window else True)
        logits = (q @ k.transpose(-1, -2) / math.sqrt(q.shape[-1])).masked_fill(
            ~allowed, -torch.inf
        )
        return self.out_proj((logits.softmax(-1) @ v).transpose(1, 2).reshape(batch, frames, d))

    def _turned(self, x: Tensor) -> Tensor:
        half = x.shape[-1] // 2
        pairs = torch.complex(x[..., :half], x[..., half:])
        angle = torch.arange(x.shape[-2])[:, None] * 10000.0 ** (-torch.arange(half) / half)
        turned = pairs * torch.polar(torch.ones_like(angle), angle)
        return torch.cat([turned.real, turned.imag], -1)


class PlainLayer(nn.Module):
    """Self-attention, what is heard, feed-forward."""

    def __init__(self, o: Any) -> None:
        super().__init__()
        d = o.d_model
        self.o = o
        self.self_attn = PlainAttention(d, o.num_heads, o.window, o.positions == "rotary")
        if o.align_audio:
            self.value, self.audio_out = nn.Linear(d, d), nn.Linear(d, d)
        else:
            self.multihead_attn = nn.MultiheadAttention(d, o.num_heads, batch_first=True)
        self.linear1, self.linear2 = nn.Linear(d, o.ff_dim), nn.Linear(o.ff_dim, d)
        self.norm1, self.norm3 = nn.LayerNorm(d), nn.LayerNorm(d)
        # What is heard at a frame itself does not look at the frame: nothing to normalise before it.
        unread = o.align_audio and o.norm_first
        self.norm2 = nn.Identity() if unread else nn.LayerNorm(d)
        count = {"input": 0, "scale_shift": 1}.get(o.time_condition, 3)
        for place in range(count):
            self.add_module(f"film{place + 1}", PlainPlace(d, o.time_condition, o.film_form))

    def forward(self, x: Tensor, memory: Tensor, code: Tensor) -> Tensor:
        activation = functional.gelu if self.o.activation == "gelu" else functional.relu

        def cross(y: Tensor) -> Tensor:
            if self.o.align_audio:  # the mask leaves one key: its weight is 1
                return self.audio_out(self.value(memory))
            return self.multihead_attn(y, memory, memory)[0]

        steps = [
            (self.norm1, self.self_attn),
            (self.norm2, cross),
            (self.norm3, lambda y: self.linear2(activation(self.linear1(y)))),
        ]
        for number, (norm, step) in enumerate(steps):
            y = step(norm(x) if self.o.norm_first else x)
            if self.o.time_condition == "input":
                x = x + y
            else:
                shared = self.o.time_condition == "scale_shift"
                x = getattr(self, "film1" if shared else f"film{number + 1}")(x, y, code)
            x = x if self.o.norm_first else norm(x)
        return x


class PlainFaceTalk(nn.Module):
    """FaceTalk's denoiser as Sec. 4 and the supplement describe it; parameters named as the library's."""

    def __init__(self, o: Any) -> None:
        super().__init__()
        self.o = o
        d = o.d_model
        self.input_proj, self.output_proj = nn.Linear(o.code_dim, d), nn.Linear(d, o.code_dim)
        self.audio_proj = nn.Linear(o.audio_dim, d)
        self.time_mlp = nn.ModuleList(nn.Linear(d, d) for _ in range(o.time_layers))
        self.layers = nn.ModuleList(PlainLayer(o) for _ in range(o.num_layers))
        if o.norm_first:
            self.norm = nn.LayerNorm(d)
        if o.positions == "learned":
            self.positions = nn.Parameter(torch.empty(o.max_frames, d))
        self.null_audio = nn.Parameter(torch.empty(o.audio_dim))
        for name in ("code_mean", "code_scale", "rest_code"):
            self.register_buffer(name, torch.empty(o.code_dim))
        self.register_buffer("landmark_basis", torch.empty(o.code_dim, 204))

    def forward(self, x: Tensor, timestep: Tensor, audio: Tensor, drop_audio: Tensor) -> Tensor:
        frames = torch.arange(x.shape[1])
        memory = self.audio_proj(torch.where(drop_audio[:, None, None], self.null_audio, audio))
        code = self._sinusoids(timestep)
        for number, linear in enumerate(self.time_mlp):
            code = linear(functional.silu(code) if number else code)
        z = self.input_proj(x)
        if self.o.positions == "learned":
            z = z + self.positions[: x.shape[1]]
        elif not self.o.align_audio:
            z = z + self._sinusoids(frames)
        if not self.o.align_audio:
            memory = memory + self._sinusoids(frames)
        if self.o.time_condition == "input":
            z = z + code[:, None]
        for layer in self.layers:
            z = layer(z, memory, code)
        return self.output_proj(self.norm(z) if self.o.norm_first else z)

    def _sinusoids(self, t: Tensor) -> Tensor:
        half = self.o.d_model // 2
        angles = t[:, None] * 10000.0 ** (-torch.arange(half) / half)
        return torch.cat([angles.sin(), angles.cos()], -1)


def small(**fields: Any) -> FaceTalk:
    torch.manual_seed(0)
    model = FaceTalk(**{**SMALL, **fields})
    with torch.no_grad():
        for parameter in model.parameters():  # nothing is left at its first 0 or 1
            parameter.add_(0.3 * torch.randn_like(parameter))
    return model.eval()


def batch(seed: int = 1) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {
        "x": torch.randn(3, 9, 6, generator=generator),
        "timestep": torch.tensor([0, 400, 999]),
        "audio": torch.randn(3, 9, 5, generator=generator),
        "drop_audio": torch.tensor([False, True, False]),
    }


@pytest.mark.parametrize("fields", VARIANTS, ids=str)
def test_is_the_paper_in_plain_torch(fields: dict[str, Any]) -> None:
    model = small(**fields)
    plain = PlainFaceTalk(model.options)
    plain.load_state_dict(model.state_dict())
    # Sums of at most a hundred float32 terms, twice over.
    torch.testing.assert_close(model(**batch()), plain(**batch()), atol=2e-5, rtol=1e-4)


@pytest.mark.parametrize("fields", VARIANTS, ids=str)
def test_training_follows_under_autocast(fields: dict[str, Any]) -> None:
    model = FaceTalk(**{**SMALL, "d_model": 32, **fields})
    given = batch()
    target = torch.randn(3, 9, 6, generator=torch.Generator().manual_seed(5))
    assert_follows_float32(model, lambda: model(**given), target)


@pytest.mark.parametrize("fields", VARIANTS, ids=str)
def test_every_parameter_learns(fields: dict[str, Any]) -> None:
    """None is left without a gradient: several processes then need no search for unused ones."""
    model = small(**fields)
    model(**batch()).square().sum().backward()
    assert [name for name, p in model.named_parameters() if p.grad is None] == []


def test_is_a_torch_module(tmp_path: Any) -> None:
    model = small(codes="weights", expressions=[f"e{i}" for i in range(6)])
    basis = torch.randn(6, 204)
    model.set_code_statistics(
        mean=torch.ones(6), scale=torch.full((6,), 2.0), rest=torch.ones(6), landmark_basis=basis
    )
    expected = model(**batch())
    model.save_pretrained(tmp_path / "saved")
    twins = [
        copy.deepcopy(model),
        pickle.loads(pickle.dumps(model)),
        FaceTalk.from_pretrained(tmp_path / "saved"),
    ]
    for twin in twins:
        torch.testing.assert_close(twin(**batch()), expected)
        assert twin.options == model.options
    codes = torch.randn(2, 6)
    torch.testing.assert_close(model.normalize(codes), (codes - 1) / 2)
    torch.testing.assert_close(model.denormalize(model.normalize(codes)), codes)
    moved = model.landmarks(codes)
    torch.testing.assert_close(moved, ((codes - 1) @ basis).view(2, 68, 3))


def test_generate_and_stream_agree() -> None:
    model = small()
    features = torch.randn(30, 5, generator=torch.Generator().manual_seed(3))
    options = GenerateOptions(num_steps=4, audio_guidance=1.5, precision="float32")
    whole = generate(model, features, options=options, seed=7)
    assert whole.shape == (30, 6)
    torch.testing.assert_close(generate(model, features, options=options, seed=[2, 7])[1], whole)
    assert torch.equal(generate(model, features, options=options, seed=7), whole)
    stream = CodeStream(model, options=options, seed=7)
    pieces = [stream.push(features[a:b]) for a, b in ((0, 3), (3, 20), (20, 30))]
    torch.testing.assert_close(torch.cat(pieces), whole, atol=1e-5, rtol=1e-4)
    halved = GenerateOptions(num_steps=4, audio_guidance=1.5, precision="bfloat16")
    coarse = generate(model, features, options=halved, seed=7)
    assert 0 < float((coarse - whole).norm() / whole.norm()) < 0.1  # 8 bits, four steps


def with_landmarks(codes: str) -> FaceTalk:
    """A model whose codes move landmarks by millimetres."""
    model = small(codes=codes, expressions=[f"e{i}" for i in range(6)])
    generator = torch.Generator().manual_seed(1)
    model.set_code_statistics(
        mean=torch.full((6,), 0.3),
        scale=torch.full((6,), 0.3),
        rest=torch.zeros(6),
        landmark_basis=0.004 * torch.randn(6, 204, generator=generator),
    )
    return model


@pytest.mark.parametrize("codes", ["weights", "head"])
def test_codes_come_back_from_their_landmarks(codes: str) -> None:
    model = with_landmarks(codes)
    given = torch.rand(20, 6, generator=torch.Generator().manual_seed(2))
    # The prior pulls by (0.3 mm)^2 / ((4 mm)^2 204 0.3^2) of the distance to the mean.
    found = codes_from_landmarks(model, model.landmarks(given))
    torch.testing.assert_close(found, given, atol=2e-3, rtol=0)
    smooth = codes_from_landmarks(model, model.landmarks(given), smoothness=1e4)
    assert float(smooth.diff(dim=0).square().sum()) < 0.2 * float(given.diff(dim=0).square().sum())


def test_weights_from_landmarks_stay_within_their_range() -> None:
    model = with_landmarks("weights")
    given = torch.rand(20, 6, generator=torch.Generator().manual_seed(2)) * 2 - 0.5
    found = codes_from_landmarks(model, model.landmarks(given))
    assert float(found.min()) >= 0 and float(found.max()) <= 1
    # Optimal within the range: no weight that is free to move would lower the error by moving.
    inside = (found > 1e-3) & (found < 1 - 1e-3)
    codes = found.double().requires_grad_()
    basis = model.get_buffer("landmark_basis").double()
    error = (codes @ basis - given.double() @ basis).square().sum() / 0.0003**2
    cost = error + ((codes - 0.3) / 0.3).square().sum()
    (gradient,) = torch.autograd.grad(cost, codes)
    assert float(gradient[inside].abs().max()) < 1e-3 * float(gradient.abs().max())
    with pytest.raises(ValueError, match=r"\(T, 68, 3\)"):
        codes_from_landmarks(model, torch.zeros(4, 204))
    with pytest.raises(ValueError, match="finite"):
        codes_from_landmarks(model, torch.full((4, 68, 3), torch.nan))


def test_misfits_are_refused() -> None:
    model = small()
    with pytest.raises(ValueError, match=r"expected features \(T, 5\)"):
        generate(model, torch.zeros(4, 6))
    with pytest.raises(ValueError, match="film_form"):
        FaceTalk(**SMALL, filmform="plain")
    with pytest.raises(ValueError, match="hear their own moment"):
        CodeStream(small(align_audio=False))
    with pytest.raises(ValueError, match="max_frames = 12"):
        generate(small(positions="learned"), torch.zeros(13, 5))
