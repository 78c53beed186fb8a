"""The parametric head against a plain PyTorch one, and what its options promise."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from plain_head import PlainDeformation, PlainHead, PlainIdentity, randomize
from torch import Tensor

from freetalk.head import (
    HeadOptions,
    ParametricHead,
    load_nphm,
    nphm_paper_options,
    nphm_small_options,
)

TINY: dict[str, Any] = {
    "global_dim": 6,
    "local_dim": 4,
    "identity_hidden": 24,
    "anchor_hidden": 8,
    "expression_dim": 5,
    "identity_code_dim": 4,
    "deformation_hidden": 24,
    "deformation_layers": 4,
}


def tiny(**fields: Any) -> ParametricHead:
    torch.manual_seed(0)
    head = ParametricHead(**{**TINY, **fields})
    randomize(head)
    return head


def queries(head: ParametricHead, batch: int = 2, count: int = 50) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    points = torch.rand(batch, count, 3, generator=generator) - 0.5
    z_id = 0.3 * torch.randn(batch, head.identity_dim, generator=generator)
    z_exp = 0.3 * torch.randn(batch, head.options.expression_dim, generator=generator)
    return points, z_id, z_exp


@pytest.fixture(scope="module")
def paper_heads() -> tuple[PlainHead, ParametricHead]:
    plain = PlainHead()
    randomize(plain)
    head = ParametricHead(HeadOptions(min_weight=0.0))
    state = head.state_dict()
    own = {
        name: tensor
        for name, tensor in state.items()
        if name.startswith(("identity.", "deformation_"))
    }
    assert own.keys() == plain.state_dict().keys()
    head.load_state_dict({**state, **plain.state_dict()})
    return plain, head


def test_published_sizes_equal_the_plain_head(
    paper_heads: tuple[PlainHead, ParametricHead],
) -> None:
    """Rounding of float32 over a dozen layers stays below 1e-5 of fields of about 0.1."""
    plain, head = paper_heads
    assert head.identity_dim == 1344
    points, z_id, z_exp = queries(head)
    torch.testing.assert_close(
        head(points, z_id, z_exp), plain(points, z_id, z_exp), atol=1e-5, rtol=0
    )
    torch.testing.assert_close(head.anchors(z_id), plain.identity.predict_anchors(z_id))


def test_gradients_equal_the_plain_head(paper_heads: tuple[PlainHead, ParametricHead]) -> None:
    plain, head = paper_heads
    points, z_id, z_exp = queries(head, count=20)
    found = {}
    for name, model in (("plain", plain), ("native", head)):
        model.zero_grad()
        inputs = [tensor.clone().requires_grad_() for tensor in (points, z_id, z_exp)]
        model(*inputs).square().sum().backward()
        found[name] = [tensor.grad for tensor in inputs] + [
            parameter.grad for key, parameter in sorted(model.named_parameters())
        ]
    assert len(found["plain"]) == len(found["native"])
    for ours, theirs in zip(found["native"], found["plain"], strict=True):
        assert ours is not None and theirs is not None
        scale = float(theirs.abs().max()) + 1e-6
        torch.testing.assert_close(ours / scale, theirs / scale, atol=1e-4, rtol=0)


def test_gathered_members_follow_all_of_them() -> None:
    """What members below a thousandth of the weight say is left out, and their weight goes to the others."""
    head = tiny()
    points, z_id, z_exp = queries(head, count=400)
    dense = tiny(min_weight=0.0)
    dense.load_state_dict(head.state_dict())
    with torch.no_grad():
        ours, all_of_them = head(points, z_id, z_exp), dense(points, z_id, z_exp)
    assert not torch.equal(ours, all_of_them)
    assert float((ours - all_of_them).abs().max()) < 0.04 * float(all_of_them.abs().max())
    assert float((ours - all_of_them).abs().mean()) < 1e-3 * float(all_of_them.abs().max())


@pytest.mark.parametrize("sees", ["none", "hyper", "expression"])
def test_second_derivatives_pass_gradcheck(sees: str) -> None:
    """Losses on normals differentiate the field's gradient; off the thresholds everything is smooth."""
    head = tiny(identity_sees=sees, min_weight=0.0, kernel_width=0.3).double()
    points, z_id, z_exp = (tensor.double() for tensor in queries(head, 1, 3))
    with torch.no_grad():
        for layer in head.parameters():
            layer.mul_(0.3)
    inputs = [tensor.requires_grad_() for tensor in (points, z_id, z_exp)]
    assert torch.autograd.gradcheck(head, inputs, atol=1e-6)
    assert torch.autograd.gradgradcheck(head, inputs, atol=1e-4, rtol=1e-3)


def test_forward_heads_are_inverted_with_gradients_of_the_implicit_function() -> None:
    head = tiny(direction="forward").double()
    points, z_id, z_exp = (tensor.double() for tensor in queries(head, 1, 6))
    with torch.no_grad():
        for name, parameter in head.named_parameters():
            if name.startswith("deformation_"):
                parameter.mul_(0.7)
    canonical, hyper = head.to_canonical(points, z_id, z_exp)
    assert hyper is None
    torch.testing.assert_close(head.to_posed(canonical, z_id, z_exp), points, atol=1e-5, rtol=0)
    inputs = [tensor.requires_grad_() for tensor in (points, z_id, z_exp)]
    assert torch.autograd.gradcheck(
        lambda *codes: head.to_canonical(*codes)[0], inputs, atol=1e-4, rtol=1e-3, eps=1e-4
    )


def test_the_background_is_outside_in_eval_mode_alone_where_asked() -> None:
    """As NPHM evaluates it: far from all anchors the field is positive, whatever the background learned."""
    head = tiny(background="outside", min_weight=0.0)
    points, z_id, _z_exp = queries(head, 1)
    plain = PlainIdentity(6, 4, 39, 16, 24, 4, 8)
    plain.load_state_dict(
        {k.removeprefix("identity."): v for k, v in head.state_dict().items() if k.startswith("identity.")}
    )  # fmt: skip
    far = points + 3
    for outside in (False, True):
        head.train(not outside)
        torch.testing.assert_close(
            head.canonical_sdf(far, z_id), plain(far, z_id, outside), atol=1e-7, rtol=1e-4
        )
    assert bool((head.canonical_sdf(far, z_id) > 0).all())


def test_codes_of_one_identity_do_not_touch_another() -> None:
    head = tiny()
    points, z_id, z_exp = queries(head)
    together = head(points, z_id, z_exp)
    alone = torch.cat([head(points[b, None], z_id[b, None], z_exp[b, None]) for b in range(2)])
    torch.testing.assert_close(together, alone, atol=1e-6, rtol=1e-5)


def test_mirrored_members_make_a_mirrored_field() -> None:
    """Anchors mirrored in pairs under equal codes: the pairs' part of the field is symmetric in x."""
    head = tiny(num_anchors=32, num_pairs=16)
    with torch.no_grad():
        state = head.state_dict()
        state["identity.anchors"][1::2] = state["identity.anchors"][::2] * torch.tensor([-1, 1, 1])
        state["identity.mlp_pos.4.weight"].zero_()
        state["identity.mlp_pos.4.bias"].zero_()
    z_id = torch.randn(1, head.identity_dim)
    local = z_id[:, 6:].unflatten(1, (33, 4))
    local[:, 1:32:2] = local[:, :32:2]
    points = head.state_dict()["identity.anchors"][None, ::2] + 0.01
    mirrored = points * torch.tensor([-1.0, 1.0, 1.0])
    torch.testing.assert_close(
        head.canonical_sdf(points, z_id), head.canonical_sdf(mirrored, z_id), atol=1e-5, rtol=0
    )
    assert float(head.symmetry_distance(z_id)) == 0.0


def test_autocast_follows_float32() -> None:
    """Hidden channels in bfloat16; coordinates and the last layer keep their digits."""
    head = tiny(identity_hidden=64, deformation_hidden=64)
    inputs = queries(head, count=300)
    exact = head(*inputs)
    with torch.autocast("cpu", torch.bfloat16):
        rounded = head(*inputs)
        rounded.square().sum().backward()
    assert rounded.dtype == torch.float32
    assert float((rounded - exact).detach().norm() / exact.detach().norm()) < 0.02
    assert all(p.grad is not None and bool(p.grad.isfinite().all()) for p in head.parameters())


def test_maps_give_codes() -> None:
    head = tiny(num_coefficients=7, num_weights=3, direction="both")
    with torch.no_grad():
        head.state_dict()["canonical_weights"].copy_(torch.tensor([0.25, 0.0, 0.0]))
    assert head.identity_code(torch.randn(2, 7)).shape == (2, head.identity_dim)
    assert not head.expression_code(torch.tensor([[0.25, 0, 0]])).any()
    assert head.expression_code(torch.tensor([[0.0, 0, 0]])).any()
    first, again = (head.sample_identity(3, seed=4) for _ in range(2))
    assert torch.equal(first, again) and first.shape == (3, head.identity_dim)
    assert not torch.equal(first, head.sample_identity(3, seed=5))


def test_heads_are_saved_copied_and_pickled(tmp_path: Path) -> None:
    head = tiny(direction="both", num_weights=3)
    head.save_pretrained(tmp_path / "head")
    inputs = queries(head)
    for other in (
        ParametricHead.from_pretrained(tmp_path / "head"),
        copy.deepcopy(head),
        pickle.loads(pickle.dumps(head)),
    ):
        assert other.options == head.options
        assert torch.equal(other(*inputs), head(*inputs))


def test_published_files_are_read_by_their_names(tmp_path: Path) -> None:
    """Files of the layout that the public training code writes, the anchors' MLP of 128 among them."""
    identity, moves = PlainIdentity(64, 32, 39, 16, 200, 4, 128), PlainDeformation(1461, 32, 200, 512, 6)  # fmt: skip
    for module in (identity, moves):
        randomize(module)
    shape = {name: t for name, t in identity.state_dict().items() if name != "anchors"}
    codes = torch.randn(5, 1344)
    torch.save(
        {"epoch": 3, "decoder_state_dict": shape, "latent_codes_state_dict": {"weight": codes}},
        tmp_path / "identity.tar",
    )
    torch.save({"decoder_state_dict": moves.state_dict()}, tmp_path / "moves.tar")
    np.save(tmp_path / "anchors.npy", identity.anchors[None, None].numpy())
    head = load_nphm(*(tmp_path / name for name in ("identity.tar", "moves.tar", "anchors.npy")))
    assert head.options.anchor_hidden == 128 and head.options.direction == "forward"
    points, z_id, z_exp = queries(head, 1, 30)
    expected = points + moves(points, z_id, identity.predict_anchors(z_id), z_exp)
    torch.testing.assert_close(head.to_posed(points, z_id, z_exp), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(head.state_dict()["identity_mean"], codes.mean(0))

    shape["ensembled_deep_sdf.lin2.weight"] = torch.zeros(24, 199, 200)
    torch.save({"decoder_state_dict": shape}, tmp_path / "other.tar")
    with pytest.raises(RuntimeError, match=r"lin2\.weight has shape \(24, 199, 200\)"):
        load_nphm(tmp_path / "other.tar", tmp_path / "moves.tar", tmp_path / "anchors.npy")
    with pytest.raises(RuntimeError, match="holds no anchors"):
        load_nphm(tmp_path / "identity.tar", tmp_path / "moves.tar", tmp_path / "identity.tar")


def test_sizes_are_the_stated_ones() -> None:
    count = sum(
        parameter.numel() for parameter in ParametricHead(nphm_small_options()).parameters()
    )
    assert 1.2e6 < count < 1.45e6
    assert nphm_paper_options().direction == "forward"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"direction": "up"}, "direction must be"),
        ({"identity_sees": "hyper", "direction": "forward"}, "backward network"),
        ({"identity_hidden": 8}, "must exceed"),
        ({"num_pairs": 20}, "anchors"),
        ({"min_weight": 1.0}, "min_weight"),
        ({"box_max": [0.0, 0.0, -2.0]}, "box_min"),
    ],
)
def test_options_are_checked(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ParametricHead(**{**TINY, **fields})


def test_wrong_shapes_are_named() -> None:
    head = tiny()
    points, z_id, z_exp = queries(head)
    with pytest.raises(ValueError, match="identity"):
        head(points, z_id[:, :-1], z_exp)
    with pytest.raises(ValueError, match="expression"):
        head(points, z_id, z_exp[:1])
    with pytest.raises(ValueError, match="points"):
        head.canonical_sdf(points[..., :2], z_id)
    with pytest.raises(ValueError, match="no map"):
        head.identity_code(torch.zeros(1, 3))
