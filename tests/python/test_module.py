"""Native modules behave as torch.nn.Module in everything a training does with one."""

from __future__ import annotations

import copy
import gc
import json
import pickle

import pytest
import torch
import torch.nn.utils.parametrize
import torch.nn.utils.prune
from torch import nn

from freetalk.ats import Ats, AtsOptions

SMALL = {
    "d_model": 16,
    "num_layers": 2,
    "num_heads": 2,
    "ff_dim": 32,
    "audio_dim": 5,
    "max_frames": 12,
    "dropout": 0.0,
}


def inputs(batch: int = 2, frames: int = 7, dtype: torch.dtype = torch.float32) -> dict:
    generator = torch.Generator().manual_seed(0)
    emotion = torch.zeros(batch, 14, dtype=dtype)
    emotion[:, 3] = 1
    return {
        "x": torch.randn(batch, frames, 204, generator=generator).to(dtype),
        "timestep": torch.arange(batch) * 100,
        "audio": torch.randn(batch, frames, 5, generator=generator).to(dtype),
        "emotion": emotion,
        "intensity": torch.full((batch,), 2.0, dtype=dtype),
    }


def run(model: nn.Module, **changes: object) -> torch.Tensor:
    values = {**inputs(dtype=next(model.parameters()).dtype), **changes}
    return model(values.pop("x"), values.pop("timestep"), **values)


@pytest.fixture
def model() -> Ats:
    torch.manual_seed(0)
    return Ats(**SMALL).eval()


def test_optimiser_steps_reach_the_native_tensors(model: Ats) -> None:
    before = run(model).detach().clone()
    optimiser = torch.optim.AdamW(model.parameters(), lr=1e-2)
    loss_before = run(model).square().mean()
    loss_before.backward()
    optimiser.step()
    after = run(model)
    assert after.square().mean() < loss_before
    assert not torch.allclose(before, after)


def test_every_parameter_but_the_null_conditions_gets_a_gradient(model: Ats) -> None:
    run(model).square().mean().backward()
    silent = {
        name for name, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0
    }
    assert silent == {"null_audio", "null_affect"}


def test_double_converts_parameters_and_buffers_together(model: Ats) -> None:
    single = run(model)
    model.double()
    assert {t.dtype for t in model.state_dict().values()} == {torch.float64}
    double = run(model)
    assert double.dtype == torch.float64
    torch.testing.assert_close(single.double(), double, atol=1e-5, rtol=1e-4)


def test_state_dict_round_trip_and_copies_give_equal_outputs(model: Ats) -> None:
    model.set_motion_statistics(torch.full((204,), 0.01), torch.full((204,), 0.5))
    other = Ats(**SMALL).eval()
    other.load_state_dict(model.state_dict())
    clones = [other, copy.deepcopy(model), pickle.loads(pickle.dumps(model))]
    for clone in clones:
        assert torch.equal(run(clone), run(model))
        assert torch.equal(clone.normalize(torch.ones(204)), model.normalize(torch.ones(204)))
    with torch.no_grad():
        next(iter(clones[1].parameters())).add_(1)
    assert not torch.equal(run(clones[1]), run(model))


def test_training_mode_reaches_dropout() -> None:
    torch.manual_seed(0)
    model = Ats(**{**SMALL, "dropout": 0.5})
    model.train()
    assert not torch.equal(run(model), run(model))
    model.eval()
    assert torch.equal(run(model), run(model))


def test_autocast_runs_in_bfloat16(model: Ats) -> None:
    with torch.autocast("cpu", dtype=torch.bfloat16):
        low = run(model)
    assert low.dtype == torch.bfloat16
    # bfloat16 has 8 bits of mantissa; a few layers lose a little more
    torch.testing.assert_close(low.float(), run(model), atol=0.1, rtol=0.1)


def test_save_and_load_pretrained(model: Ats, tmp_path) -> None:
    model.save_pretrained(tmp_path)
    assert torch.equal(run(Ats.from_pretrained(tmp_path)), run(model))
    (tmp_path / "config.json").write_text('{"format": "other", "options": {}}')
    with pytest.raises(RuntimeError, match="freetalk-ats"):
        Ats.from_pretrained(tmp_path)


def test_distributed_data_parallel_wraps_it(model: Ats, tmp_path) -> None:
    def backward() -> None:
        # Gone before the process group: the last to hold a group joins its threads, and the
        # wrapper would do so holding the interpreter's lock, which they may be waiting for.
        wrapped = nn.parallel.DistributedDataParallel(model, find_unused_parameters=True)
        run(wrapped).square().mean().backward()

    torch.distributed.init_process_group(
        "gloo", init_method=f"file://{tmp_path}/rendezvous", rank=0, world_size=1
    )
    try:
        backward()
        gc.collect()
        assert model.get_parameter("output_proj.weight").grad.abs().sum() > 0
    finally:
        torch.distributed.destroy_process_group()


def test_options_reject_unknown_names_with_the_nearest() -> None:
    with pytest.raises(ValueError, match="num_layers"):
        AtsOptions(num_layer=3)
    with pytest.raises(ValueError, match="multiple"):
        AtsOptions(d_model=10, num_heads=3)
    options = AtsOptions(d_model=64)
    assert AtsOptions.from_dict(options.to_dict()) == options
    assert pickle.loads(pickle.dumps(options)) == options


def test_wrong_shapes_are_value_errors(model: Ats) -> None:
    with pytest.raises(ValueError, match="audio"):
        run(model, audio=torch.zeros(2, 6, 5))


@pytest.mark.parametrize("norm_first", [False, True])
def test_denoiser_equals_torch_transformer_decoder(norm_first: bool) -> None:
    """Same weights in torch.nn.TransformerDecoder, with a -inf band mask: equal in float64 to rounding."""
    torch.manual_seed(1)
    model = Ats(**{**SMALL, "norm_first": norm_first, "band_radius": 2}).double().eval()
    layer = nn.TransformerDecoderLayer(
        16, 2, 32, 0.0, activation="gelu", batch_first=True, norm_first=norm_first
    )
    reference = nn.TransformerDecoder(layer, 2, nn.LayerNorm(16) if norm_first else None)
    state = {n: t for n, t in model.state_dict().items() if n.startswith(("layers.", "norm."))}
    reference.double().eval().load_state_dict(state)
    values = inputs(dtype=torch.float64)
    frames = values["x"].shape[1]
    index = torch.arange(frames)
    mask = (index[:, None] - index[None]).abs() > 2
    p = dict(model.named_parameters())
    memory = values["audio"] @ p["memory_proj.weight"].T + p["memory_proj.bias"]
    memory = memory + p["memory_positions"][:frames]
    captured = values["x"] @ p["input_proj.weight"].T + p["input_proj.bias"]
    captured = captured + p["target_positions"][:frames] + _conditioning(model, values)[:, None]
    out = reference(captured, memory, memory_mask=mask)
    out = out @ p["output_proj.weight"].T + p["output_proj.bias"]
    # float64 rounding; the timestep code is computed in float32, the same in both
    torch.testing.assert_close(run(model), out, atol=1e-9, rtol=1e-9)


def _conditioning(model: Ats, values: dict) -> torch.Tensor:
    """g_t + g_c written out."""
    from freetalk.nn import sinusoidal_code

    p = dict(model.named_parameters())

    def linear(name: str, x: torch.Tensor) -> torch.Tensor:
        return x @ p[f"{name}.weight"].T + p[f"{name}.bias"]

    silu = nn.functional.silu
    time = linear(
        "time_out", silu(linear("time_in", sinusoidal_code(values["timestep"], 16).double()))
    )
    emotion = p["emotion_embedding.weight"][3].expand(2, -1)
    intensity = p["intensity_embedding.weight"][1].expand(2, -1)
    affect = linear("affect_out", silu(linear("affect_in", torch.cat([emotion, intensity], 1))))
    return time + affect


class Doubled(nn.Module):
    """A parametrization: twice the parameter."""

    def forward(self, weight: torch.Tensor) -> torch.Tensor:
        return 2 * weight


def twice(model: Ats, name: str) -> Ats:
    """A copy whose tensor `name` holds twice the values."""
    other = copy.deepcopy(model)
    with torch.no_grad():
        other.get_parameter(name).mul_(2)
    return other


WEIGHT = "output_proj.weight"


def test_assigned_state_is_what_the_native_module_computes_with(model: Ats) -> None:
    torch.manual_seed(1)
    other = Ats(**SMALL).eval()
    parent = nn.ModuleDict({"ats": model})
    state = {f"ats.{name}": tensor.clone() for name, tensor in other.state_dict().items()}
    parent.load_state_dict(state, assign=True)
    assert torch.equal(run(model), run(other))
    with torch.no_grad():
        model.get_parameter(WEIGHT).add_(1)
    assert torch.equal(state[f"ats.{WEIGHT}"], model.get_parameter(WEIGHT))  # no copy was made
    assert not torch.equal(run(model), run(other))


def test_assigned_state_may_have_another_dtype(model: Ats) -> None:
    before = run(model).double()
    model.load_state_dict({k: v.double() for k, v in model.state_dict().items()}, assign=True)
    # float32 rounds at 6e-8 of the value, a few layers deep
    torch.testing.assert_close(run(model).float(), before.float(), atol=1e-5, rtol=1e-4)
    assert run(model).dtype == torch.float64


def test_functional_call_computes_with_the_given_tensors_and_differentiates_them(
    model: Ats,
) -> None:
    given = {name: p.detach().clone() for name, p in model.named_parameters()}
    given[WEIGHT] = (2 * given[WEIGHT]).requires_grad_()
    values = inputs()
    x = values.pop("x").requires_grad_()
    timestep = values.pop("timestep")
    expected = twice(model, WEIGHT)
    x_grad, weight_grad = torch.autograd.grad(
        expected(x, timestep, **values).square().sum(), (x, expected.get_parameter(WEIGHT))
    )
    before = run(model).detach()
    out = torch.func.functional_call(model, given, (x, timestep), values)
    assert torch.equal(out, expected(x, timestep, **values))
    assert torch.equal(run(model), before)  # the module's own are back, before the backward too
    out.square().sum().backward()
    torch.testing.assert_close(given[WEIGHT].grad, weight_grad)
    torch.testing.assert_close(x.grad, x_grad)
    assert all(p.grad is None and p.requires_grad for p in model.parameters())
    assert torch.equal(run(model), before)


@pytest.mark.slow
def test_functional_call_in_double_of_a_single_module_passes_gradcheck(model: Ats) -> None:
    given = {name: t.detach().double() for name, t in model.state_dict().items()}
    values = inputs(batch=1, frames=2, dtype=torch.float64)

    def last_bias(bias: torch.Tensor) -> torch.Tensor:
        call = {k: v for k, v in values.items() if k not in ("x", "timestep")}
        own = {**given, "output_proj.bias": bias}
        return torch.func.functional_call(model, own, (values["x"], values["timestep"]), call)[
            ..., :3
        ]

    assert torch.autograd.gradcheck(last_bias, given["output_proj.bias"].clone().requires_grad_())
    assert {p.dtype for p in model.parameters()} == {torch.float32}


def test_parametrized_weights_are_used_trained_and_removed(model: Ats) -> None:
    expected = run(twice(model, WEIGHT)).detach()
    nn.utils.parametrize.register_parametrization(model.output_proj, "weight", Doubled())
    assert torch.equal(run(model), expected)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        run(model)  # fills the cache of casts
        low = run(model)
    assert low.dtype == torch.bfloat16
    optimiser = torch.optim.SGD(model.parameters(), lr=1e-3)
    loss = run(model).square().mean()
    loss.backward()
    assert model.output_proj.parametrizations.weight.original.grad.abs().sum() > 0
    optimiser.step()
    assert run(model).square().mean() < loss
    with pytest.raises(RuntimeError, match="remove_parametrizations"):
        copy.deepcopy(model)
    trained = run(model).detach()
    nn.utils.parametrize.remove_parametrizations(model.output_proj, "weight")
    assert torch.equal(run(model), trained)
    assert torch.equal(run(copy.deepcopy(model)), trained)


def test_what_a_native_module_cannot_follow_is_said_in_one_sentence(model: Ats) -> None:
    state = dict(model.state_dict())
    values = inputs()
    x, timestep = values.pop("x"), values.pop("timestep")
    with pytest.raises(ValueError, match=r"'output_proj.bias' must be \(204,\)"):
        torch.func.functional_call(
            model, {**state, "output_proj.bias": torch.ones(3)}, (x, timestep), values
        )

    def loss(bias: torch.Tensor) -> torch.Tensor:
        own = {**state, "output_proj.bias": bias}
        return torch.func.functional_call(model, own, (x, timestep), values).sum()

    with pytest.raises(RuntimeError, match=r"torch\.autograd\.grad"):
        torch.func.grad(loss)(state["output_proj.bias"])
    nn.utils.prune.l1_unstructured(model.output_proj, "weight", amount=0.5)
    with pytest.raises(RuntimeError, match="parametrize"):
        run(model)


def test_a_save_that_stopped_between_its_files_reads_as_the_new_model(model: Ats, tmp_path) -> None:
    model.save_pretrained(tmp_path)
    older = (tmp_path / "config.json").read_text()
    torch.manual_seed(2)
    wider = Ats(**{**SMALL, "d_model": 32}).eval()
    wider.save_pretrained(tmp_path)
    (tmp_path / "config.json").write_text(older)
    loaded = Ats.from_pretrained(tmp_path)
    assert loaded.options.d_model == 32
    assert torch.equal(run(loaded), run(wider))


def test_a_configuration_edited_by_hand_is_the_one_that_is_read(model: Ats, tmp_path) -> None:
    model.save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    config["options"]["dropout"] = 0.25
    (tmp_path / "config.json").write_text(json.dumps(config))
    assert Ats.from_pretrained(tmp_path).options.dropout == 0.25


def test_weights_of_a_newer_version_are_refused(model: Ats, tmp_path) -> None:
    model.save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    (tmp_path / "config.json").write_text(json.dumps({**config, "version": 2}))
    with pytest.raises(RuntimeError, match=r"version 2.*update freetalk"):
        Ats.from_pretrained(tmp_path)
