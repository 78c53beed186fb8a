"""Calls of a native module in which other tensors stand for some of its own, gradients intact.

``torch.func.functional_call``, parametrizations and assignments put other tensors where a module registers its own.
A native module reads the tensors that it made; for the length of a call these take the data of the others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.autograd.graph import get_gradient_edge
from torch.utils._pytree import tree_flatten, tree_unflatten

from freetalk import _native

#: What may stand in a differentiable call beside tensors: it carries no gradient that could be lost.
_PLAIN = (
    bool,
    int,
    float,
    str,
    type(None),
    _native.geometry.SurfaceOperators,
    _native.geometry.FaceOperators,
)


class Replaced:
    """A bound module whose methods run with other tensors.

    Args:
        impl: the bound module.
        names: of the tensors that are replaced.
        natives: the module's own.
        tensors: those that stand for them, of the same shapes.

    Raises:
        ValueError: a shape differs.
        RuntimeError: a tensor belongs to a transform of ``torch.func``, which can't see into a native module.
    """

    def __init__(
        self, impl: Any, names: Sequence[str], natives: Sequence[Tensor], tensors: Sequence[Tensor]
    ) -> None:
        for name, native, tensor in zip(names, natives, tensors, strict=True):
            if tensor.shape != native.shape:
                raise ValueError(
                    f"'{name}' must be {tuple(native.shape)}, its replacement is {tuple(tensor.shape)}"
                )
            if torch._C._functorch.is_functorch_wrapped_tensor(tensor):
                raise RuntimeError(
                    f"'{name}' is replaced within a transform of torch.func (grad, vmap, jvp ...), which can't see "
                    "into a native module: call torch.autograd.grad on functional_call instead"
                )
        self._impl = impl
        self._natives = tuple(natives)
        self._tensors = tuple(tensors)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._impl, name)
        return self._method(value) if callable(value) else value

    def _method(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            leaves, structure = tree_flatten((args, kwargs))
            places = [i for i, leaf in enumerate(leaves) if isinstance(leaf, Tensor)]
            inputs = [leaves[i] for i in places]
            if not torch.is_grad_enabled() or not any(
                tensor.requires_grad for tensor in (*self._tensors, *inputs)
            ):
                with _holding(self._natives, self._tensors):
                    return function(*args, **kwargs)
            result: list[Any] = []

            def run(values: Sequence[Tensor]) -> list[Tensor]:
                for i, value in zip(places, values, strict=True):
                    leaves[i] = value
                given, named = tree_unflatten(leaves, structure)
                outputs, shape = tree_flatten(function(*given, **named))
                _check_differentiable([*leaves, *outputs])
                result.append(shape)
                return list(outputs)

            outputs = _Call.apply(run, self._natives, len(self._tensors), *self._tensors, *inputs)
            return tree_unflatten(list(outputs), result[0])

        return call


def _check_differentiable(values: Sequence[Any]) -> None:
    for value in values:
        if not isinstance(value, (Tensor, *_PLAIN)):
            raise RuntimeError(
                f"gradients of replaced tensors can't pass through {type(value).__name__}: "
                "call forward, or call this within torch.no_grad()"
            )


@contextmanager
def _holding(natives: Sequence[Tensor], tensors: Sequence[Tensor]) -> Iterator[None]:
    """Gives native tensors the data of others, and takes it back."""
    kept = [(native.data, native.requires_grad) for native in natives]
    torch.clear_autocast_cache()  # it knows tensors by their address, not by their data
    try:
        for native, tensor in zip(natives, tensors, strict=True):
            native.data = tensor.data
            native.requires_grad_(tensor.requires_grad)
        yield
    finally:
        for native, (data, requires_grad) in zip(natives, kept, strict=True):
            native.data = data
            native.requires_grad_(requires_grad)
        torch.clear_autocast_cache()


class _Call(torch.autograd.Function):
    """One differentiable call: its graph ends at the native tensors, whose gradients go to the replacements."""

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        run: Callable[[Sequence[Tensor]], list[Tensor]],
        natives: tuple[Tensor, ...],
        count: int,
        *values: Tensor,
    ) -> tuple[Tensor, ...]:
        tensors, inputs = values[:count], values[count:]
        with torch.enable_grad(), _holding(natives, tensors):
            own = [value.detach().requires_grad_(value.requires_grad) for value in inputs]
            edges = [
                get_gradient_edge(leaf) if leaf.requires_grad else None for leaf in (*natives, *own)
            ]
            outputs = run(own)
        ctx.save_for_backward(*tensors)
        ctx.set_materialize_grads(False)
        ctx.call = natives, edges, outputs
        results = tuple(output.detach() for output in outputs)
        ctx.mark_non_differentiable(
            *(
                result
                for result, output in zip(results, outputs, strict=True)
                if not output.requires_grad
            )
        )
        return results

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Any, ...]:
        natives, edges, outputs = ctx.call
        reached = [
            (out, grad) for out, grad in zip(outputs, grads, strict=True) if grad is not None
        ]
        wanted = [edge for edge in edges if edge is not None]
        with _holding(natives, ctx.saved_tensors):
            found = iter(
                torch.autograd.grad(
                    [out for out, _ in reached],
                    wanted,
                    [grad for _, grad in reached],
                    retain_graph=torch._C._autograd._get_current_graph_task_keep_graph(),
                    allow_unused=True,
                )
            )
        return (None, None, None, *(None if edge is None else next(found) for edge in edges))
