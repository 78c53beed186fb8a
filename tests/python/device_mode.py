"""A pretended device: what a GPU would refuse is an error, on a machine that has none.

Within a ``DeviceMode``, tensors of ``DEVICE`` hold their numbers on the host, out of sight: an operation computes them
there, refuses tensors of the device and of the host together (but for scalars, as CUDA does), and notes every wait
for the device. Nothing of the library's CPU code sees a tensor of the host, so it takes the way that a GPU takes.
Networks made within ``building()`` are of the device from the start, with native parameters and all.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")  # the one that the autograd engine runs without a runtime of its own
aten = torch.ops.aten

#: Copies may cross between host and device.
_COPIES = {aten._to_copy.default, aten.copy_.default}
#: Results on the host, or of a size that depends on the values: the host waits for the device.
_WAITS = {
    "_local_scalar_dense",
    "equal",
    "is_nonzero",
    "item",
    "masked_select",
    "nonzero",
    "unique_consecutive",
    "_unique2",
    "_unique",
}


class MixedDevicesError(RuntimeError):
    """An operation was given tensors of the host and of the device."""


class DeviceTensor(torch.Tensor):
    """A tensor of ``DEVICE``; its numbers are in ``host``."""

    host: torch.Tensor

    @staticmethod
    def __new__(cls, host: torch.Tensor) -> DeviceTensor:
        tensor: DeviceTensor = torch.Tensor._make_wrapper_subclass(
            cls,
            host.size(),
            strides=host.stride(),
            storage_offset=host.storage_offset(),
            dtype=host.dtype,
            device=DEVICE,
        )
        tensor.host = host
        return tensor

    def __repr__(self) -> str:  # type: ignore[override]
        return f"DeviceTensor({self.host!r})"

    def __getitem__(self, index: Any) -> torch.Tensor:
        return super().__getitem__(_with_tensors(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(_with_tensors(index), value)

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {}, on_device=True)


class DeviceMode(TorchDispatchMode):
    """Keeps host and device apart while it lives.

    Attributes:
        waits: names of the operations that waited for the device.
        uploads: number of copies from the host to the device.
    """

    def __init__(self) -> None:
        super().__init__()
        self.waits: list[str] = []
        self.uploads = 0
        self._building = False

    @contextmanager
    def building(self) -> Iterator[None]:
        """New tensors are of the device, wherever they are asked for."""
        self._building = True
        try:
            yield
        finally:
            self._building = False

    def forget(self) -> None:
        """Starts counting anew."""
        self.waits.clear()
        self.uploads = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        name = func.overloadpacket.__name__
        tensors = [t for t in tree_leaves((args, kwargs)) if isinstance(t, torch.Tensor)]
        ours = [t for t in tensors if isinstance(t, DeviceTensor)]
        if any(t.device == DEVICE and not isinstance(t, DeviceTensor) for t in tensors):
            raise NotImplementedError(f"{func}: a tensor of the device has lost its numbers")
        asked = kwargs.get("device")
        on_device = bool(ours) if asked is None else torch.device(asked) == DEVICE
        if self._building and not tensors:
            on_device = True
        if func in _COPIES:
            if func is aten.copy_.default:
                on_device = isinstance(args[0], DeviceTensor)
            source = args[1] if func is aten.copy_.default else args[0]
            if isinstance(source, DeviceTensor) and not on_device:
                self.waits.append(name)
            self.uploads += on_device and not isinstance(source, DeviceTensor) and source.dim() > 0
        elif ours:
            indices = _indices(func, args)
            self._refuse_mixture(func, args, [t for t in tensors if not _among(t, indices)])
            self.uploads += sum(not isinstance(t, DeviceTensor) for t in indices)
            by_mask = any(t.dtype in (torch.bool, torch.uint8) for t in indices)
            counts = func is aten.repeat_interleave.Tensor and kwargs.get("output_size") is None
            if name in _WAITS or by_mask or counts:
                self.waits.append(name)
        return _run(func, args, kwargs, on_device)

    @staticmethod
    def _refuse_mixture(func: Any, args: Any, tensors: list[torch.Tensor]) -> None:
        changed = [
            value
            for argument, value in zip(func._schema.arguments, args, strict=False)
            if argument.alias_info is not None and argument.alias_info.is_write
        ]
        for tensor in tensors:
            scalar = tensor.dim() == 0 and not _among(tensor, changed)
            if not isinstance(tensor, DeviceTensor) and not scalar:
                raise MixedDevicesError(
                    f"{func}: a tensor of the host, {tuple(tensor.shape)} {tensor.dtype}, "
                    "among tensors of the device"
                )


def on_host(tensor: torch.Tensor) -> torch.Tensor:
    """The numbers of a tensor of the device or of the host, on the host."""
    return tensor.host if isinstance(tensor, DeviceTensor) else tensor.detach()


def _with_tensors(index: Any) -> Any:
    """Lists of numbers in x[...] as tensors: of lists torch itself makes tensors without numbers on ``DEVICE``."""
    parts = index if isinstance(index, tuple) else (index,)
    parts = tuple(torch.tensor(p) if isinstance(p, (list, tuple)) else p for p in parts)
    return parts if isinstance(index, tuple) else parts[0]


def _among(tensor: torch.Tensor, others: list[torch.Tensor]) -> bool:
    return any(tensor is other for other in others)


def _indices(func: Any, args: Any) -> list[torch.Tensor]:
    """Of x[...]: CUDA takes them from the host, too."""
    if func.overloadpacket in (aten.index, aten.index_put, aten.index_put_):
        return [t for t in args[1] if t is not None]
    return []


def _run(func: Any, args: Any, kwargs: Any, on_device: bool) -> Any:
    """Computes on the host; the result is of the device or of the host."""
    if func is aten._fused_sdp_choice.default:
        return 0  # plain products: what is fused is a matter of the device

    def hosted(value: Any) -> Any:
        if isinstance(value, DeviceTensor):
            return value.host
        return torch.device("cpu") if value == DEVICE and isinstance(value, torch.device) else value

    def placed(value: Any) -> Any:
        return DeviceTensor(value) if on_device and isinstance(value, torch.Tensor) else value

    results = func(*tree_map(hosted, args), **tree_map(hosted, kwargs))
    named = {**dict(zip([a.name for a in func._schema.arguments], args, strict=False)), **kwargs}
    written = [
        named[a.name]
        for a in func._schema.arguments
        if a.alias_info is not None and a.alias_info.is_write and a.name in named
    ]
    for tensor in written:
        if isinstance(tensor, DeviceTensor) and tensor.host.shape != tensor.shape:
            raise NotImplementedError(f"{func} changes a tensor's shape in place")
    if any(r.alias_info is not None and r.alias_info.is_write for r in func._schema.returns):
        return written[0] if len(func._schema.returns) == 1 else tuple(written)
    return tree_map(placed, results)
