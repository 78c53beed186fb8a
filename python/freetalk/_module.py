"""The adapter that makes a torch.nn.Module of a native one, sharing its very tensors."""

from __future__ import annotations

import copy
import json
import os
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import torch
from torch import nn

from freetalk import _native
from freetalk._replaced import Replaced

Self = TypeVar("Self", bound="NativeModule")


class NativeModule(nn.Module):
    """A C++ module as a ``torch.nn.Module``.

    Parameters and buffers are the native ones (no copies), registered under their dotted names, so optimisers,
    ``state_dict``, ``.to``, autocast, DistributedDataParallel, ``copy.deepcopy`` and pickling work as usual.
    Tensors that are put in their place (``load_state_dict(assign=True)``, ``functional_call``, parametrizations,
    assignments) are those that the native module computes with.

    Subclasses set ``_impl_type`` (bound Impl class), ``_options_type`` and ``_format`` (of config.json).
    """

    _impl_type: ClassVar[Any]
    _options_type: ClassVar[Any]
    _format: ClassVar[str]
    _own: Any  # the bound module
    _slots: list[tuple[str, nn.Module, str, torch.Tensor]]  # name, where it is registered, as what

    def __init__(self, options: Any = None, **fields: Any) -> None:
        super().__init__()
        if options is None:
            options = self._options_type(**fields)
        elif fields:
            options = self._options_type.from_dict({**options.to_dict(), **fields})
        self._bind(self._impl_type(options))

    def _bind(self, impl: Any) -> None:
        """Takes a bound module, once, after ``nn.Module.__init__``."""
        object.__setattr__(self, "_own", impl)
        self._adopt()
        self.register_load_state_dict_post_hook(_take_assigned)

    @property
    def _impl(self) -> Any:
        """The bound module, computing with the tensors that are registered now."""
        names, natives, tensors = [], [], []
        for name, parent, leaf, native in self._slots:
            if parent._parameters.get(leaf) is native or parent._buffers.get(leaf) is native:
                continue
            if parent._forward_pre_hooks:
                raise RuntimeError(
                    f"'{name}' is made anew by a hook (torch.nn.utils.prune, weight_norm ...) that a native module "
                    "never runs: use torch.nn.utils.parametrize or torch.nn.utils.parametrizations"
                )
            names.append(name)
            natives.append(native)
            tensors.append(getattr(parent, leaf))
        return Replaced(self._own, names, natives, tensors) if names else self._own

    @property
    def _plain_impl(self) -> Any:
        """The bound module for native calls that take it whole.

        Raises:
            RuntimeError: other tensors stand for some of its own, which those calls would not see.
        """
        impl = self._impl
        if isinstance(impl, Replaced):
            raise RuntimeError(
                "this call reads the module's own tensors, but functional_call, a parametrization or an assignment "
                "put others in their place: load them with load_state_dict, or call "
                "torch.nn.utils.parametrize.remove_parametrizations"
            )
        return impl

    @property
    def options(self) -> Any:
        """The options this module was built from."""
        return self._own.options

    def _adopt(self) -> None:
        object.__setattr__(self, "_slots", [])
        for name, tensor in self._own.named_parameters():
            if type(tensor) is torch.Tensor:
                requires_grad = tensor.requires_grad
                tensor.__class__ = nn.Parameter
                tensor.requires_grad_(requires_grad)
            else:  # of a class that a dispatch mode made, such as a fake tensor: it stays so
                tensor._is_param = True
            parent, leaf = self._container(name)
            parent.register_parameter(leaf, tensor)
            self._slots.append((name, parent, leaf, tensor))
        for name, tensor in self._own.named_buffers():
            parent, leaf = self._container(name)
            parent.register_buffer(leaf, tensor)
            self._slots.append((name, parent, leaf, tensor))

    def _container(self, name: str) -> tuple[nn.Module, str]:
        *path, leaf = name.split(".")
        module: nn.Module = self
        for part in path:
            child = module._modules.get(part)
            if child is None:
                child = _Container()
                module.add_module(part, child)
            module = child
        return module, leaf

    def _apply(self, fn: Any, recurse: bool = True) -> Any:
        if torch.__future__.get_overwrite_module_params_on_conversion():
            raise RuntimeError(
                "native modules change their tensors in place; leave "
                "torch.__future__.set_overwrite_module_params_on_conversion off"
            )
        super()._apply(fn, recurse)
        self._take_registered()
        return self

    def _take_registered(self) -> None:
        """Gives the native tensors the data of those registered in their place, and registers them again."""
        for _, parent, leaf, native in self._slots:
            registers: tuple[dict[str, Any], ...] = (parent._parameters, parent._buffers)
            for registered in registers:
                current = registered.get(leaf)
                if current is not None and current is not native:
                    native.data = current.data
                    registered[leaf] = native

    def train(self: Self, mode: bool = True) -> Self:
        """Sets training mode, in the native module too."""
        super().train(mode)
        self._own.train(mode)
        return self

    def forward(self, *args: Any, **kwargs: Any) -> Any:
        """The native forward pass."""
        return self._impl.forward(*args, **kwargs)

    def __deepcopy__(self: Self, memo: dict[int, Any]) -> Self:
        clone = type(self)(copy.deepcopy(self.options))
        memo[id(self)] = clone
        reference = next(self.parameters())
        clone.to(device=reference.device, dtype=reference.dtype)
        clone.load_state_dict(self._own_state())
        for (_, ours), (_, theirs) in zip(
            clone.named_parameters(), self.named_parameters(), strict=True
        ):
            ours.requires_grad_(theirs.requires_grad)
        return clone.train(self.training)

    def __reduce__(self) -> Any:
        return _rebuild, (type(self), self.options, self._own_state(), self.training)

    def _own_state(self) -> dict[str, torch.Tensor]:
        state = {name: tensor.detach() for name, tensor in self.state_dict().items()}
        if state.keys() != {name for name, *_ in self._slots}:
            raise RuntimeError(
                "a module with parametrizations can't be copied, pickled or saved: call "
                "torch.nn.utils.parametrize.remove_parametrizations first"
            )
        return state

    def save_pretrained(self, directory: str | os.PathLike[str], **extra: Any) -> None:
        """Writes ``config.json`` (options and ``extra``) and ``model.safetensors`` into a folder.

        Args:
            directory: folder to write to; made if missing.
            extra: further JSON values for config.json, such as ``training={...}``.
        """
        config = {
            "format": self._format,
            "version": 1,
            "options": self.options.to_dict(),
            **extra,
        }
        _native.core.save_model_files(os.fspath(directory), json.dumps(config), self._own_state())

    @classmethod
    def from_pretrained(cls: type[Self], directory: str | os.PathLike[str]) -> Self:
        """Loads ``config.json`` and ``model.safetensors`` from a folder.

        Args:
            directory: a folder that ``save_pretrained`` or ``freetalk train`` wrote.

        Raises:
            RuntimeError: a file is missing, of another format or of a newer version, or tensors do not fit the
                options.
        """
        path = Path(directory)
        options = _native.core.read_model_options(str(path), cls._format)
        module = cls(cls._options_type.from_dict(json.loads(options)))
        module.load_state_dict(_native.core.load_safetensors(str(path / "model.safetensors")))
        return module.eval()


class _Container(nn.Module):
    """Holds tensors of one level of a dotted name."""


def _take_assigned(module: nn.Module, _: Any) -> None:
    assert isinstance(module, NativeModule)
    module._take_registered()


def _rebuild(
    cls: type[NativeModule], options: Any, state: dict[str, torch.Tensor], training: bool
) -> NativeModule:
    module = cls(options)
    reference = next(iter(state.values()))
    module.to(device=reference.device)
    for name, tensor in module.state_dict().items():
        if tensor.dtype != state[name].dtype:
            module.to(dtype=state[name].dtype)
            break
    module.load_state_dict(state)
    return module.train(training)
