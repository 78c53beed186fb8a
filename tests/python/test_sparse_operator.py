"""SparseOperator and torch.ops.freetalk.sparse_product: algebra, torch's own checks of an operation, compilation."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import scipy.sparse
import torch
from test_nn import grid
from torch import Tensor, nn

from freetalk.geometry import SparseOperator, concatenate, surface_operators
from freetalk.nn import DiffusionNet, sparse_product

PRODUCT = torch.ops.freetalk.sparse_product


def random_operator(
    rows: int = 9, columns: int = 5, dtype: torch.dtype = torch.float64
) -> SparseOperator:
    return SparseOperator(
        torch.randn(rows, columns, dtype=dtype) * (torch.rand(rows, columns) < 0.4)
    )


@pytest.mark.parametrize("index", [torch.int32, torch.int64])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.slow
def test_the_operation_passes_torchs_checks(dtype: torch.dtype, index: torch.dtype) -> None:
    """Schema, autograd, fake tensors and tracing with dynamic shapes."""
    torch.manual_seed(0)
    matrix = random_operator(dtype=dtype)
    parts = [part if part.is_floating_point() else part.to(index) for part in matrix.tensors()]
    for requires_grad in (False, True):
        x = torch.randn(2, 5, 3, dtype=dtype, requires_grad=requires_grad)
        torch.library.opcheck(PRODUCT.default, (*parts, x))
        torch.testing.assert_close(PRODUCT(*parts, x), matrix.to_dense() @ x)


def test_devices_without_a_kernel_of_ours_get_the_same_products() -> None:
    """What CUDA runs, given tensors of the host; 1e-12 leaves room for the order of sums."""
    torch.manual_seed(1)
    matrix, x = random_operator(), torch.randn(3, 5, 4, dtype=torch.float64)
    cuda = torch._C.DispatchKeySet(torch._C.DispatchKey.CUDA)
    composed = PRODUCT.default.redispatch(cuda, *matrix.tensors(), x)
    torch.testing.assert_close(composed, matrix.to_dense() @ x, atol=1e-12, rtol=1e-12)


def test_the_transpose_is_the_transpose() -> None:
    torch.manual_seed(2)
    matrix = random_operator(rows=7, columns=11)
    assert matrix.shape == (7, 11) and matrix.transposed().shape == (11, 7)
    assert torch.equal(matrix.transposed().to_dense(), matrix.to_dense().T)


def test_empty_rows_and_matrices_without_entries_give_zeros() -> None:
    matrix = SparseOperator(torch.zeros(4, 3))
    assert torch.equal(sparse_product(matrix, torch.ones(2, 3, 5)), torch.zeros(2, 4, 5))


def test_scipy_and_torch_read_it_without_a_copy() -> None:
    torch.manual_seed(3)
    matrix = random_operator()
    csr = matrix.to_sparse_csr()
    assert csr.values().data_ptr() == matrix.values.data_ptr()
    ours = scipy.sparse.csr_array((matrix.values, matrix.columns, matrix.rows), matrix.shape)
    np.testing.assert_array_equal(ours.toarray(), matrix.to_dense())


def test_pickling_and_conversion_keep_the_numbers() -> None:
    torch.manual_seed(4)
    matrix = random_operator()
    copy = pickle.loads(pickle.dumps(matrix))
    assert all(torch.equal(a, b) for a, b in zip(copy.tensors(), matrix.tensors(), strict=True))
    half = matrix.to(torch.float32)
    assert half.values.dtype == torch.float32 and half.rows.dtype == torch.int32
    assert torch.equal(half.to_dense(), matrix.to_dense().float())


def test_gradients_of_a_batch_are_those_of_its_meshes() -> None:
    """X components of all meshes, then Y components of all."""
    parts = [surface_operators(*grid(side), k=5, cache=False) for side in (4, 6, 3)]
    batch = concatenate(parts).gradients
    halves = [part.gradients.to_dense().chunk(2) for part in parts]
    expected = torch.cat([torch.block_diag(*(h[i] for h in halves)) for i in (0, 1)])
    assert torch.equal(batch.to_dense(), expected)
    assert torch.equal(batch.transposed().to_dense(), expected.T)


def test_autocast_leaves_products_alone() -> None:
    torch.manual_seed(5)
    matrix = random_operator(dtype=torch.float32)
    x = torch.randn(2, 5, 3, requires_grad=True)
    expected = sparse_product(matrix, x)
    with torch.autocast("cpu", torch.bfloat16):
        assert torch.equal(sparse_product(matrix, x), expected)
        low = x.detach().bfloat16().requires_grad_(True)
        product = PRODUCT(*matrix.tensors(), low)
        assert product.dtype == torch.float32
        product.sum().backward()
    assert torch.equal(product, sparse_product(matrix, low.float()))
    assert low.grad is not None and low.grad.dtype == torch.bfloat16


class _UsersNetwork(nn.Module):
    """A network of somebody's own around the operation."""

    def __init__(self, matrix: SparseOperator) -> None:
        super().__init__()
        self.matrix = matrix.tensors()
        self.linear = nn.Linear(3, 3)

    def forward(self, x: Tensor) -> Tensor:
        return torch.tanh(PRODUCT(*self.matrix, self.linear(x))).square().sum(-1)


@pytest.mark.slow
def test_a_users_network_compiles_into_one_graph() -> None:
    """fullgraph=True raises at a graph break; forward, backward and another batch size agree."""
    torch.manual_seed(6)
    network = _UsersNetwork(random_operator(dtype=torch.float32))
    compiled = torch.compile(network, fullgraph=True, backend="aot_eager")
    for batch in (2, 4):
        x = torch.randn(batch, 5, 3, requires_grad=True)
        network.zero_grad()
        expected = torch.autograd.grad(network(x).sum(), [x, *network.parameters()])
        found = torch.autograd.grad(compiled(x).sum(), [x, *network.parameters()])
        torch.testing.assert_close(found, expected)


@pytest.mark.slow
def test_native_networks_work_inside_compiled_functions() -> None:
    """They run as they are; what is around them is compiled."""
    operators = surface_operators(*grid(), k=10, cache=False).to(torch.float32)
    net = DiffusionNet(in_channels=3, out_channels=2, width=4, num_blocks=1)
    x = torch.randn(2, 36, 3)

    def loss(x: Tensor) -> Tensor:
        return (2 * net(x + 1, operators)).sin().sum()

    expected = torch.autograd.grad(loss(x), list(net.parameters()))
    found = torch.autograd.grad(torch.compile(loss, backend="aot_eager")(x), list(net.parameters()))
    torch.testing.assert_close(found, expected)
    compiled = torch.compile(net, backend="aot_eager")
    torch.testing.assert_close(compiled(x, operators), net(x, operators))
