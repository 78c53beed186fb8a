"""Face gradients, divergence, Poisson solves, PoissonNet and Jacobian fields."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
import torch
from test_nn_diffusion_net import wavy_grid
from torch import Tensor
from torch.nn import functional

from freetalk.geometry import concatenate, cotan_laplacian, surface_operators
from freetalk.nn import (
    JacobianField,
    PoissonNet,
    VertexMlp,
    face_divergence,
    face_gradients,
    integrate_jacobians,
    poisson_solve,
)


def two_sheets() -> tuple[np.ndarray, np.ndarray]:
    """Two parts, and a vertex that no face uses."""
    a, faces_a = wavy_grid(5, 4)
    b, faces_b = wavy_grid(4, 4, phase=1.0)
    vertices = np.concatenate([a, b + [0, 0, 2.0], [[9.0, 9.0, 9.0]]])
    return vertices, np.concatenate([faces_a, faces_b + len(a)]).astype(np.int32)


def operators_of(mesh: tuple[np.ndarray, np.ndarray]) -> Any:
    return surface_operators(*mesh, k=4, cache=False)


def test_gradients_of_linear_functions_are_their_slopes() -> None:
    vertices, _ = mesh = wavy_grid(6, 5)
    faces = operators_of(mesh).faces()
    slope = torch.tensor([[0.3, -1.2], [2.0, 0.5], [-0.7, 1.1]], dtype=torch.float64)  # (3, C)
    values = torch.from_numpy(vertices) @ slope
    gradients = face_gradients(faces, values[None])[0].view(2, -1, 2)  # components, F, C
    projected = torch.einsum("fkd,dc->kfc", faces.frames[:, :2], slope)
    torch.testing.assert_close(gradients, projected, atol=1e-10, rtol=0)


def test_divergence_of_gradient_is_the_cotangent_laplacian() -> None:
    mesh = wavy_grid(6, 5)
    faces = operators_of(mesh).faces()
    laplacian = torch.from_numpy(cotan_laplacian(*mesh).toarray())
    x = torch.randn(2, 30, 3, dtype=torch.float64)
    result = face_divergence(faces, face_gradients(faces, x))
    torch.testing.assert_close(result, laplacian @ x, atol=1e-10, rtol=1e-10)


def test_solutions_satisfy_the_equation_for_many_right_hand_sides() -> None:
    faces = operators_of(two_sheets()).faces()
    rhs = torch.randn(3, 37, 45, dtype=torch.float64)  # 135 columns: whole blocks and a part
    u = poisson_solve(faces, rhs, regularization=1e-3)
    back = face_divergence(faces, face_gradients(faces, u)) + 1e-3 * u
    torch.testing.assert_close(back, rhs, atol=1e-10, rtol=1e-10)


def test_solve_passes_gradcheck_twice() -> None:
    faces = operators_of(wavy_grid(4, 3)).faces()
    rhs = torch.randn(2, 12, 2, dtype=torch.float64, requires_grad=True)

    def solve(rhs: Tensor) -> Tensor:
        return poisson_solve(faces, rhs, regularization=0.1)

    assert torch.autograd.gradcheck(solve, (rhs,))
    assert torch.autograd.gradgradcheck(solve, (rhs,))


def test_a_solver_without_regularization_is_refused() -> None:
    faces = operators_of(wavy_grid(4, 3)).faces()
    with pytest.raises(ValueError, match="regularization"):
        poisson_solve(faces, torch.zeros(1, 12, 1, dtype=torch.float64), regularization=0.0)


def test_operators_follow_scale_and_rotation() -> None:
    vertices, triangles = wavy_grid(5, 4)
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64)).Q
    turn = turn * torch.linalg.det(turn)  # a rotation, not a reflection
    moved = surface_operators(2.5 * vertices @ turn.numpy().T, triangles, k=4, cache=False)
    expected = moved.faces()
    found = operators_of((vertices, triangles)).scaled(2.5).turned(turn).faces()
    for name in ("areas", "frames"):
        torch.testing.assert_close(getattr(found, name), getattr(expected, name))
    torch.testing.assert_close(found.gradients.to_dense(), expected.gradients.to_dense())


def test_coincident_vertices_move_together() -> None:
    """A sheet cut along a line of doubled vertices has one translation, not two."""
    vertices, triangles = wavy_grid(6, 3)
    right = triangles.min(axis=1) >= 9
    doubled = np.flatnonzero(np.isin(np.arange(18), triangles[right]) & (np.arange(18) < 12))
    copies = {old: 18 + index for index, old in enumerate(doubled)}
    cut = triangles.copy()
    cut[right] = np.vectorize(lambda v: copies.get(v, v))(triangles[right])
    torn = surface_operators(np.concatenate([vertices, vertices[doubled]]), cut, k=4, cache=False)
    assert torn.faces().components.max() == 0
    target = torch.randn(1, 18, 3, dtype=torch.float64)
    whole = operators_of((vertices, triangles)).faces()
    gradients = face_gradients(whole, target).view(1, 2, -1, 3)
    jacobians = torch.einsum("bkfc,fkd->bfcd", gradients, whole.frames[:, :2])
    found = integrate_jacobians(torn.faces(), jacobians)
    expected = torch.cat([target, target[:, doubled]], 1)
    expected = expected - expected.mean(1, keepdim=True)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


def test_jacobians_of_a_map_give_the_map_back() -> None:
    """Each part centred; 1e-6 is the regularization 1e-9 over the smallest eigenvalue."""
    faces = operators_of(two_sheets()).faces()
    target = torch.randn(2, 37, 3, dtype=torch.float64)
    gradients = face_gradients(faces, target).view(2, 2, -1, 3)
    jacobians = torch.einsum("bkfc,fkd->bfcd", gradients, faces.frames[:, :2])
    found = integrate_jacobians(faces, jacobians)
    for part in range(3):
        inside = faces.components == part
        centred = target[:, inside] - target[:, inside].mean(1, keepdim=True)
        torch.testing.assert_close(found[:, inside], centred, atol=1e-6, rtol=0)


def test_translations_move_each_part_as_predicted() -> None:
    """With only the last layer's bias set, every part moves by it, whatever its size."""
    operators = operators_of(two_sheets())
    net = JacobianField(in_channels=2, width=4, num_layers=1, translation=True).double()
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.zero_()
        dict(net.named_parameters())["last_lin.bias"][9:] = torch.tensor([1.0, 2.0, 3.0])
    moved = net(torch.zeros(1, 37, 2, dtype=torch.float64), operators)[0]
    expected = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64).expand(36, 3)
    torch.testing.assert_close(moved[:36], expected)
    assert not moved[36].any()  # belongs to no face


def plain_poisson_net(state: dict[str, Tensor], x: Tensor, operators: Any, blocks: int) -> Tensor:
    """PoissonNet's formulas with dense matrices, on (V, C)."""
    faces = operators.faces()
    gradient, areas = faces.gradients.to_dense(), faces.areas.repeat(2)
    count = len(faces.areas)
    system = gradient.T @ (areas[:, None] * gradient) + 1e-6 * torch.eye(len(x), dtype=x.dtype)
    weights = operators.mass / operators.mass.sum()

    def linear(name: str, value: Tensor) -> Tensor:
        return functional.linear(value, state[f"{name}.weight"], state.get(f"{name}.bias"))

    def complex_layer(name: str, z: Tensor) -> Tensor:
        weight = torch.complex(state[f"{name}.lin_real.weight"], state[f"{name}.lin_imag.weight"])
        z = z @ weight.T
        if f"{name}.mag_bias" in state:
            size = torch.sqrt(z.abs() ** 2 + 1e-8)
            z = z * functional.gelu(size + state[f"{name}.mag_bias"]) / (size + 1e-8)
        return z

    x = linear("proj_in", x)
    for index in range(blocks):
        name = f"blocks.{index}"
        slopes = gradient @ x
        z = plain = torch.complex(slopes[:count], slopes[count:])
        modulator = f"{name}.grad_mlp.modulator.modulator"
        inner = functional.gelu(linear(f"{modulator}.0", x[faces.faces].mean(1)))
        phase, scale = linear(f"{modulator}.2", inner).chunk(2, -1)
        z = z * torch.polar(functional.softplus(scale) + 1e-8, phase)
        for layer in range(2):
            z = complex_layer(f"{name}.grad_mlp.layers.{layer}", z)
        field = torch.cat([z.real, z.imag])
        u = torch.linalg.solve(system, gradient.T @ (areas[:, None] * field))
        parts = [x, u - weights @ u]
        if f"{name}.grad_scaler" in state:
            products = (complex_layer(f"{name}.grad_features", z) * plain.conj()).real
            shares = torch.zeros(len(x), count, dtype=x.dtype)
            for corner in range(3):
                shares[faces.faces[:, corner], torch.arange(count)] += faces.areas
            mean = shares / shares.sum(1, keepdim=True)
            parts.append(torch.tanh((mean @ products) * state[f"{name}.grad_scaler"]))
        mlp = f"{name}.vert_mlp"
        for number, value in ((1, None), (2, None)):
            value = torch.cat(parts, -1) if number == 1 else x
            hidden = functional.gelu(linear(f"{mlp}.mlp{number}.layers.0", value))
            x = x + state[f"{mlp}.ls{number}"] * linear(f"{mlp}.mlp{number}.layers.3", hidden)
    return linear("head", x)


@pytest.mark.parametrize("products", [False, True])
def test_poisson_net_equals_its_formulas_under_the_public_names(products: bool) -> None:
    torch.manual_seed(0)
    operators = operators_of(wavy_grid(6, 5))
    net = PoissonNet(in_channels=3, out_channels=2, width=6, num_blocks=2,
                     gradient_products=products).double()  # fmt: skip
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    x = torch.randn(2, 30, 3, dtype=torch.float64)
    state = dict(net.state_dict())
    expected = torch.stack([plain_poisson_net(state, frame, operators, 2) for frame in x])
    torch.testing.assert_close(net(x, operators), expected, atol=1e-8, rtol=1e-8)


@pytest.mark.parametrize("net", [PoissonNet(in_channels=2, out_channels=1, width=2, num_blocks=1),
                                 JacobianField(in_channels=2, width=3, translation=True),
                                 VertexMlp(in_channels=2, out_channels=1, width=3)],
                         ids=lambda net: type(net).__name__)  # fmt: skip
def test_gradients_pass_gradcheck_and_batches_equal_each_mesh_alone(net: Any) -> None:
    torch.manual_seed(0)
    net = copy.deepcopy(net).double()
    parts = [operators_of(wavy_grid(4, 3)), operators_of(wavy_grid(3, 3, phase=2.0))]
    inputs = [torch.randn(1, count, 2, dtype=torch.float64) for count in (12, 9)]
    inputs[0].requires_grad_(True)
    assert torch.autograd.gradcheck(lambda x: net(x, parts[0]), (inputs[0],), atol=1e-6)
    together = net(torch.cat(inputs, 1), concatenate(parts))
    alone = torch.cat([net(x, part) for x, part in zip(inputs, parts, strict=True)], 1)
    torch.testing.assert_close(together, alone, atol=1e-9, rtol=1e-9)
    again = pickle.loads(pickle.dumps(net))
    assert torch.equal(again(inputs[0], parts[0]), net(inputs[0], parts[0]))
