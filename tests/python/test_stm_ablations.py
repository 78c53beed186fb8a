"""STM's component substitutions by name, and the default network against its formulas in plain PyTorch."""

from __future__ import annotations

import copy
import math
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch
from plain_nets import PlainDiffusionNet, plain_mesh
from test_nn_diffusion_net import wavy_grid

import freetalk
from freetalk.geometry import surface_operators
from freetalk.stm import Stm, StmOptions
from freetalk.train.config import load_config

SMALL: dict[str, Any] = {
    "encoder_width": 16, "encoder_blocks": 1, "feature_dim": 16, "decoder_width": 16,
    "decoder_blocks": 1, "k_eig": 8, "gcn_layers": 1, "gcn_hidden": 16, "index_code_dim": 16,
    "attention_heads": 2, "attention_dim": 16,
}  # fmt: skip
SHIPPED = Path(freetalk.__file__).parent / "pretrained" / "open-small" / "stm"


def face_sheet(rows: int = 9, columns: int = 7) -> tuple[Any, Any]:
    """A wavy sheet of about the size of a face, metres."""
    vertices, triangles = wavy_grid(rows, columns)
    return 0.1 * vertices, triangles


def prepared(options: StmOptions, rows: int = 9, columns: int = 7) -> tuple[torch.Tensor, Any]:
    vertices, triangles = face_sheet(rows, columns)
    operators = surface_operators(
        vertices / options.length_scale, triangles, k=options.k_eig, cache=False
    )
    return torch.from_numpy(vertices).float(), operators.to(dtype=torch.float32)


def moving(model: Stm) -> Stm:
    """The last layer starts at zero; here it moves, and heat diffuses."""
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if name == "decoder.last_lin.weight":
                parameter.normal_(0, 0.3)
            elif name.endswith("diffusion_time"):
                parameter.uniform_(0.001, 0.05)
    return model


def landmarks_of(frames: int) -> torch.Tensor:
    return 0.004 * torch.randn(frames, 68, 3, generator=torch.Generator().manual_seed(0))


def plain_stm(
    model: Stm, positions: torch.Tensor, operators: Any, landmarks: torch.Tensor
) -> torch.Tensor:
    """FreeTalk's Eq. 12-14 and both DiffusionNets in plain PyTorch, nothing split or shared."""
    o = model.options
    state = {name: tensor.double() for name, tensor in model.state_dict().items()}

    def net(prefix: str, *sizes: int) -> PlainDiffusionNet:
        plain = PlainDiffusionNet(*sizes).double()
        plain.load_state_dict(
            {k[len(prefix) :]: v for k, v in state.items() if k.startswith(prefix)}
        )
        return plain

    def linear(name: str, x: torch.Tensor) -> torch.Tensor:
        return x @ state[f"{name}.weight"].T + state[f"{name}.bias"]

    mesh = plain_mesh(operators)
    encoder = net("encoder.", 6, o.feature_dim, o.encoder_width, o.encoder_blocks)
    inputs = torch.cat([positions.double() / o.length_scale, operators.normals.double()], 1)
    features = encoder(inputs, mesh)
    motion = landmarks.double() / o.displacement_scale
    local, adjacency = motion, state["gcn.adjacency"]  # shipped in half precision
    for layer in range(o.gcn_layers):
        local = adjacency @ linear(f"gcn.layer_{layer}", local)
        local = torch.relu(local) if layer + 1 < o.gcn_layers else local
    codes = state["index_code"].expand(len(landmarks), -1, -1)
    joined = linear("landmark_proj", torch.cat([local, codes], -1))
    heads, size = o.attention_heads, o.attention_dim // o.attention_heads
    queries = linear("query_proj", features).view(-1, heads, size)
    keys = linear("key_proj", joined).view(-1, 68, heads, size)
    values = linear("value_proj", joined).view(-1, 68, heads, size)
    weights = torch.einsum("vhd,tnhd->tvhn", queries, keys) / math.sqrt(size)
    attended = torch.einsum("tvhn,tnhd->tvhd", weights.softmax(-1), values).flatten(2)
    everywhere = motion.flatten(1)[:, None].expand(-1, len(positions), -1)
    repeated = features.expand(len(landmarks), -1, -1)
    decoder = net("decoder.", o.feature_dim + 204 + o.attention_dim, 3, o.decoder_width,
                  o.decoder_blocks)  # fmt: skip
    fused = torch.cat([repeated, everywhere, attended], -1)
    return decoder(fused, mesh).detach() * o.displacement_scale


@pytest.mark.parametrize("source", ["shipped", "new"])
def test_the_default_network_equals_its_equations(source: str) -> None:
    """In float64; 1e-9 of the largest displacement leaves room for the order of sums."""
    torch.manual_seed(0)
    model = Stm.from_pretrained(SHIPPED) if source == "shipped" else moving(Stm(**SMALL))
    model = model.double()
    positions, operators = prepared(model.options, 12, 9)
    positions, operators = positions.double(), operators.to(dtype=torch.float64)
    landmarks = landmarks_of(3).double()
    with torch.no_grad():
        found = model(positions, operators, landmarks)
    expected = plain_stm(model, positions, operators, landmarks)
    assert (found - expected).abs().max() <= 1e-9 * expected.abs().max()


@pytest.mark.parametrize("extractor", ["mlp", "diffusionnet", "poissonnet"])
@pytest.mark.parametrize("decoder", ["mlp", "diffusionnet", "njf"])
def test_every_combination_learns_with_all_its_weights(extractor: str, decoder: str) -> None:
    torch.manual_seed(0)
    model = moving(Stm(**SMALL, extractor=extractor, decoder=decoder))
    positions, operators = prepared(model.options)
    motion = model(positions, operators, landmarks_of(2))
    assert motion.shape == (2, 63, 3)
    assert motion.isfinite().all()
    assert motion.abs().max() > 0
    motion.square().sum().backward()
    still = [name for name, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert still == []


@pytest.mark.parametrize("fusion", ["concat", "ca", "ca_concat", "gcn_ca_concat"])
def test_every_fusion_uses_what_its_name_says(fusion: str) -> None:
    torch.manual_seed(0)
    model = moving(Stm(**SMALL, fusion=fusion))
    parts = {name.split(".")[0] for name, _ in model.named_parameters()}
    assert ("gcn" in parts) == (fusion == "gcn_ca_concat")
    assert ("key_proj" in parts) == (fusion != "concat")
    width = {"concat": 16 + 204, "ca": 16 + 16}.get(fusion, 16 + 204 + 16)
    assert dict(model.named_parameters())["decoder.first_lin.weight"].shape[1] == width
    positions, operators = prepared(model.options)
    motion = model(positions, operators, landmarks_of(2))
    motion.square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in model.parameters())
    fast = model.frame_decoder(model.encode(positions, operators), operators)
    error = (fast.decode(landmarks_of(2)) - motion.detach()).abs().max()
    assert error <= 1e-5 * motion.detach().abs().max()


@pytest.mark.parametrize("kind", [{"extractor": "poissonnet", "decoder": "njf"},
                                  {"extractor": "mlp", "decoder": "mlp", "fusion": "ca"}],
                         ids=["poissonnet-njf", "mlp-mlp-ca"])  # fmt: skip
def test_substitutes_survive_copies_pickles_and_folders(
    kind: dict[str, str], tmp_path: Path
) -> None:
    model = moving(Stm(**SMALL, **kind))
    positions, operators = prepared(model.options)
    expected = model(positions, operators, landmarks_of(2))
    model.save_pretrained(tmp_path)
    for other in (
        copy.deepcopy(model),
        pickle.loads(pickle.dumps(model)),
        Stm.from_pretrained(tmp_path),
    ):
        assert other.options == model.options
        assert torch.equal(other(positions, operators, landmarks_of(2)), expected)


def test_a_mesh_without_an_eigenbasis_serves_where_none_is_used() -> None:
    model = Stm(**{**SMALL, "k_eig": 8}, extractor="poissonnet", decoder="njf")
    vertices, triangles = face_sheet()
    operators = surface_operators(vertices / 0.1, triangles, k=1, cache=False)
    positions = torch.from_numpy(vertices).float()
    model(positions, operators.to(dtype=torch.float32), landmarks_of(1))
    with pytest.raises(ValueError, match="k = 8 eigenpairs"):
        Stm(**SMALL)(positions, operators.to(dtype=torch.float32), landmarks_of(1))


@pytest.mark.parametrize(("option", "wrong", "near"), [
    ("extractor", "diffusion", "diffusionnet"), ("decoder", "nfj", "njf"),
    ("fusion", "gcn_concat", "ca_concat"),
])  # fmt: skip
def test_unknown_names_are_answered_with_the_known(option: str, wrong: str, near: str) -> None:
    with pytest.raises(ValueError, match=f"unknown {option} .{wrong}.; known: .*{near}"):
        StmOptions(**{option: wrong})


def test_configurations_choose_by_name() -> None:
    config = load_config("stm", "stm_smoke", ["model.extractor=poissonnet", "model.decoder=njf",
                                              "model.fusion=ca_concat"])  # fmt: skip
    options = StmOptions.from_dict(config.model)
    assert (options.extractor, options.decoder, options.fusion) == (
        "poissonnet",
        "njf",
        "ca_concat",
    )
