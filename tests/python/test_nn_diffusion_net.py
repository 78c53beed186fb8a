"""DiffusionNet against the plain network, for every kind of it; batches of meshes; public checkpoints."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from plain_nets import PlainDiffusionNet, plain_mesh

from freetalk.geometry import concatenate, surface_operators, unique_edges
from freetalk.nn import DiffusionNet

KINDS: list[dict[str, Any]] = [
    {},
    {"outputs_at": "edges"},
    {"outputs_at": "faces"},
    {"outputs_at": "global_mean"},
    {"with_gradient_rotations": False},
    {"with_gradient_features": False},
    {"mlp_hidden": [7, 9, 5]},
    {"diffusion_method": "implicit_dense"},
]


def wavy_grid(rows: int, columns: int, phase: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(0, 1.5, rows), np.linspace(0, 1, columns), indexing="ij")
    vertices = np.stack([x, y, 0.2 * np.sin(3 * x + 2 * y + phase)], -1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + columns, corner + 1], 1)
    upper = np.stack([corner + 1, corner + columns, corner + columns + 1], 1)
    return vertices, np.concatenate([lower, upper]).astype(np.int32)


def mesh_of(operators: Any) -> dict[str, torch.Tensor]:
    faces = operators.faces()
    gradients = faces.gradients.to_dense()
    areas = faces.areas.repeat(2)
    return {
        **plain_mesh(operators),
        "laplacian": gradients.T @ (areas[:, None] * gradients),
        "faces": faces.faces,
        "edges": unique_edges(faces.faces),
    }


def with_times(net: DiffusionNet) -> DiffusionNet:
    with torch.no_grad():
        for name, parameter in net.named_parameters():
            if name.endswith("diffusion_time"):
                parameter.copy_(torch.rand(len(parameter)) * 0.05)
    return net


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: "-".join(map(str, kind.values())) or "all")
def test_every_kind_equals_the_plain_network(kind: dict[str, Any]) -> None:
    """Same state dict, same outputs in float64; 1e-9 leaves room for the order of sums."""
    torch.manual_seed(0)
    operators = surface_operators(*wavy_grid(7, 6), k=12, cache=False)
    net = with_times(DiffusionNet(in_channels=3, out_channels=4, width=8, num_blocks=2, **kind))
    net = net.double()
    plain = PlainDiffusionNet(3, 4, 8, 2, **kind).double()
    plain.load_state_dict(net.state_dict())
    x = torch.randn(2, 42, 3, dtype=torch.float64)
    expected = plain(x, mesh_of(operators))
    torch.testing.assert_close(net(x, operators), expected, atol=1e-9, rtol=1e-9)


@pytest.mark.parametrize("method", ["spectral", "implicit_dense"])
def test_gradients_of_inputs_and_weights_pass_gradcheck(method: str) -> None:
    torch.manual_seed(1)
    operators = surface_operators(*wavy_grid(4, 3), k=6, cache=False)
    net = with_times(DiffusionNet(in_channels=2, out_channels=1, width=3, num_blocks=1,
                                  diffusion_method=method)).double()  # fmt: skip
    x = torch.randn(2, 12, 2, dtype=torch.float64, requires_grad=True)
    weights = list(net.parameters())
    # Every weight stands in the graph of the output: gradcheck perturbs them in place.
    assert torch.autograd.gradcheck(lambda x, *_: net(x, operators), (x, *weights), atol=1e-6)


@pytest.mark.parametrize("kind", [{}, {"outputs_at": "global_mean"}, {"outputs_at": "faces"},
                                  {"diffusion_method": "implicit_dense"}])  # fmt: skip
def test_a_batch_of_meshes_of_different_sizes_equals_each_alone(kind: dict[str, Any]) -> None:
    torch.manual_seed(2)
    sizes = [(5, 4), (7, 6), (4, 4)]
    parts = [
        surface_operators(*wavy_grid(*size, phase=float(index)), k=10, cache=False)
        for index, size in enumerate(sizes)
    ]
    net = with_times(DiffusionNet(in_channels=3, out_channels=2, width=8, num_blocks=2, **kind))
    net = net.double()
    inputs = [torch.randn(2, rows * columns, 3, dtype=torch.float64) for rows, columns in sizes]
    together = net(torch.cat(inputs, 1), concatenate(parts))
    alone = torch.cat([net(x, operators) for x, operators in zip(inputs, parts, strict=True)], 1)
    torch.testing.assert_close(together, alone, atol=1e-10, rtol=1e-10)


def test_heat_kernels_are_those_of_the_mesh() -> None:
    """Phi exp(-lambda t) Phi^T M of all V pairs is the heat kernel exp(-t M^-1 L), to rounding."""
    operators = surface_operators(*wavy_grid(6, 5), k=30, cache=False, regularization="relative")
    mesh = mesh_of(operators)
    basis, mass = operators.evecs, operators.mass
    root = mass.sqrt()
    symmetric = mesh["laplacian"] / (root[:, None] * root)
    for time in (0.001, 0.01, 0.1, 1.0):
        kernel = basis @ (torch.exp(-operators.evals * time)[:, None] * (basis.T * mass))
        exact = torch.linalg.matrix_exp(-time * symmetric) * root / root[:, None]
        torch.testing.assert_close(kernel, exact, atol=1e-5, rtol=0)


def test_a_public_checkpoint_loads_by_its_names_alone(tmp_path: Path) -> None:
    """The layout of the public package's .pth files: an OrderedDict of tensors, with or without prefix."""
    torch.manual_seed(3)
    plain = PlainDiffusionNet(16, 5, 12, 3, mlp_hidden=[10, 12])
    torch.save(plain.state_dict(), tmp_path / "plain.pth")
    torch.save({f"feature_extractor.{k}": v for k, v in plain.state_dict().items()},
               tmp_path / "nested.pth")  # fmt: skip
    operators = surface_operators(*wavy_grid(6, 5), k=8, cache=False)
    x = torch.randn(1, 30, 16)
    expected = plain.eval()(x, plain_mesh(operators, torch.float32))
    single = operators.to(dtype=torch.float32)
    for name, prefix in (("plain", ""), ("nested", "feature_extractor.")):
        net = DiffusionNet.from_public_checkpoint(tmp_path / f"{name}.pth", prefix=prefix)
        assert (net.options.width, net.options.num_blocks) == (12, 3)
        torch.testing.assert_close(net(x, single), expected, atol=1e-4, rtol=1e-4)
    with pytest.raises(ValueError, match="feature_extractor"):
        DiffusionNet.from_public_checkpoint(tmp_path / "nested.pth")


def test_a_checkpoint_that_is_a_program_is_refused(tmp_path: Path) -> None:
    class Program:
        def __reduce__(self) -> Any:
            return print, ("run",)

    (tmp_path / "evil.pth").write_bytes(pickle.dumps({"first_lin.weight": Program()}))
    with pytest.raises(pickle.UnpicklingError):
        DiffusionNet.from_public_checkpoint(tmp_path / "evil.pth")


def test_wrong_names_of_options_say_what_is_known() -> None:
    with pytest.raises(ValueError, match="vertices, edges, faces or global_mean"):
        DiffusionNet(outputs_at="corners")
    with pytest.raises(ValueError, match="spectral or implicit_dense"):
        DiffusionNet(diffusion_method="explicit")


def test_copies_and_pickles_give_the_same_outputs() -> None:
    operators = surface_operators(*wavy_grid(4, 4), k=6, cache=False).to(dtype=torch.float32)
    net = DiffusionNet(in_channels=3, out_channels=2, width=8, num_blocks=1, outputs_at="faces")
    x = torch.randn(1, 16, 3)
    for other in (copy.deepcopy(net), pickle.loads(pickle.dumps(net))):
        assert torch.equal(other(x, operators), net(x, operators))
