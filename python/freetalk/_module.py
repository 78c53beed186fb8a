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

Self = TypeVar("Self", bound="NativeModule")


class NativeModule(nn.Module):
    """A C++ module as a ``torch.nn.Module``.

    Parameters and buffers are the native ones (no copies), registered under their dotted names, so optimisers,
    ``state_dict``, ``.to``, autocast, DistributedDataParallel, ``copy.deepcopy`` and pickling work as usual.

    Subclasses set ``_impl_type`` (bound Impl class), ``_options_type`` and ``_format`` (of config.json).
    """

    _impl_type: ClassVar[Any]
    _options_type: ClassVar[Any]
    _format: ClassVar[str]
    _impl: Any

    def __init__(self, options: Any = None, **fields: Any) -> None:
        super().__init__()
        if options is None:
            options = self._options_type(**fields)
        elif fields:
            options = self._options_type.from_dict({**options.to_dict(), **fields})
        object.__setattr__(self, "_impl", self._impl_type(options))
        self._adopt()

    @property
    def options(self) -> Any:
        """The options this module was built from."""
        return self._impl.options

    def _adopt(self) -> None:
        for name, tensor in self._impl.named_parameters():
            requires_grad = tensor.requires_grad
            tensor.__class__ = nn.Parameter
            tensor.requires_grad_(requires_grad)
            parent, leaf = self._container(name)
            parent.register_parameter(leaf, tensor)
        self._adopt_buffers()

    def _adopt_buffers(self) -> None:
        for name, tensor in self._impl.named_buffers():
            parent, leaf = self._container(name)
            if leaf in parent._buffers:
                parent._buffers[leaf] = tensor
            else:
                parent.register_buffer(leaf, tensor)

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
        moved = dict(self.named_buffers())
        for name, tensor in self._impl.named_buffers():
            tensor.data = moved[name].data
        self._adopt_buffers()
        return self

    def train(self: Self, mode: bool = True) -> Self:
        """Sets training mode, in the native module too."""
        super().train(mode)
        self._impl.train(mode)
        return self

    def forward(self, *args: Any, **kwargs: Any) -> Any:
        """The native forward pass."""
        return self._impl.forward(*args, **kwargs)

    def __deepcopy__(self: Self, memo: dict[int, Any]) -> Self:
        clone = type(self)(copy.deepcopy(self.options))
        memo[id(self)] = clone
        reference = next(self.parameters())
        clone.to(device=reference.device, dtype=reference.dtype)
        clone.load_state_dict(self.state_dict())
        for (_, ours), (_, theirs) in zip(
            clone.named_parameters(), self.named_parameters(), strict=True
        ):
            ours.requires_grad_(theirs.requires_grad)
        return clone.train(self.training)

    def __reduce__(self) -> Any:
        state = {name: tensor.detach() for name, tensor in self.state_dict().items()}
        return _rebuild, (type(self), self.options, state, self.training)

    def save_pretrained(self, directory: str | os.PathLike[str], **extra: Any) -> None:
        """Writes ``config.json`` (options and ``extra``) and ``model.safetensors`` into a folder.

        Args:
            directory: folder to write to; made if missing.
            extra: further JSON values for config.json, such as ``training={...}``.
        """
        path = Path(directory)
        path.mkdir(parents=True, exist_ok=True)
        state = {name: tensor.detach() for name, tensor in self.state_dict().items()}
        _native.core.save_safetensors(str(path / "model.safetensors"), state)
        config = {
            "format": self._format,
            "version": 1,
            "options": self.options.to_dict(),
            **extra,
        }
        temporary = path / f".config.json.{os.getpid()}"
        temporary.write_text(json.dumps(config, indent=2) + "\n")
        temporary.replace(path / "config.json")

    @classmethod
    def from_pretrained(cls: type[Self], directory: str | os.PathLike[str]) -> Self:
        """Loads ``config.json`` and ``model.safetensors`` from a folder.

        Args:
            directory: a folder that ``save_pretrained`` or ``freetalk train`` wrote.

        Raises:
            RuntimeError: a file is missing or of another format, or tensors do not fit the options.
        """
        path = Path(directory)
        try:
            config = json.loads((path / "config.json").read_text())
        except OSError as error:
            raise RuntimeError(
                f"{path / 'config.json'}: cannot be read ({error.strerror})"
            ) from None
        except json.JSONDecodeError as error:
            raise RuntimeError(f"{path / 'config.json'}: is not JSON ({error})") from None
        if config.get("format") != cls._format:
            raise RuntimeError(
                f"{path / 'config.json'}: expected format {cls._format}, found {config.get('format')}"
            )
        module = cls(cls._options_type.from_dict(config["options"]))
        state = _native.core.load_safetensors(str(path / "model.safetensors"))
        module.load_state_dict(state)
        return module.eval()


class _Container(nn.Module):
    """Holds tensors of one level of a dotted name."""


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
