"""Processes, devices and precision of a training.

Processes are those of ``torchrun`` or ``accelerate launch``, run by Hugging Face accelerate; one process
without either is the same code with nothing to exchange.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from datetime import timedelta
from typing import Any

import torch
from torch import Tensor, nn

from freetalk.train.config import LoopOptions

#: How long processes wait for the one that validates or prepares data.
_PATIENCE = timedelta(hours=12)


class Engine:
    """This process among those that train together.

    Attributes:
        device: where this process computes.
        rank: number of this process.
        num_processes: how many train together.
        batch_size: items of a step.
        shard_size: items of one forward pass of one process.
        scaler: of fp16 gradients; passes everything on where fp16 is off.

    Args:
        options: device, precision and batch size.

    Raises:
        ValueError: CUDA is asked for and absent, or the batch does not divide.
        RuntimeError: accelerate is missing, or was configured for a way of training that this is not.
    """

    def __init__(self, options: LoopOptions) -> None:
        self._accelerator = _accelerator(choose_device(options))
        self.device: torch.device = self._accelerator.device
        self.rank: int = self._accelerator.process_index
        self.num_processes: int = self._accelerator.num_processes
        self.accumulation = options.accumulation_steps
        shards = self.num_processes * self.accumulation
        if options.batch_size % shards:
            raise ValueError(
                f"loop.batch_size {options.batch_size} must be a multiple of {self.num_processes} "
                f"processes times {self.accumulation} accumulation steps: it counts the items of a "
                "whole step"
            )
        self.batch_size = options.batch_size
        self.shard_size = options.batch_size // shards
        self._dtype = torch.float16 if options.fp16 else torch.bfloat16
        self._mixed = options.fp16 or options.bf16
        self.scaler = torch.amp.GradScaler(self.device.type, enabled=options.fp16)

    @property
    def is_main(self) -> bool:
        """Whether this process writes files and shows progress."""
        return self.rank == 0

    def use_device(self) -> None:
        """Makes the calling thread use this process's GPU."""
        if self.device.type == "cuda":
            torch.cuda.set_device(self.device)

    def prepare(self, module: nn.Module, skips_layers: bool = False) -> nn.Module:
        """The module that averages gradients over the processes.

        Args:
            module: its forward pass is all that a backward pass sees.
            skips_layers: whether a pass may leave parameters out (layer drop).
        """
        from accelerate import DistributedDataParallelKwargs

        settings = DistributedDataParallelKwargs(find_unused_parameters=skips_layers)
        self._accelerator.ddp_handler = settings
        prepared: nn.Module = self._accelerator.prepare_model(module)
        return prepared

    def autocast(self) -> AbstractContextManager[None]:
        """bfloat16 or float16 where the options ask for it."""
        return torch.autocast(self.device.type, dtype=self._dtype, enabled=self._mixed)

    def last_of_step(self, module: nn.Module, last: bool) -> AbstractContextManager[None]:
        """Gradients are exchanged only by the last of a step's passes."""
        context: AbstractContextManager[None] = (
            nullcontext() if last else self._accelerator.no_sync(module)
        )
        return context

    def mean(self, values: Tensor) -> Tensor:
        """Mean over the processes, the same in each."""
        if self.num_processes == 1:
            return values
        mean: Tensor = self._accelerator.reduce(values, reduction="mean")
        return mean

    def from_main(self, value: Any) -> Any:
        """The main process's value, in each; waits for it."""
        if self.num_processes == 1:
            return value
        from accelerate.utils import broadcast_object_list

        return broadcast_object_list([value])[0]

    @contextmanager
    def main_first(self) -> Iterator[None]:
        """The main process goes first, the others after it: for what is cached on disk."""
        with self._accelerator.main_process_first():
            yield

    def to_device(self, batch: Any) -> Any:
        """Tensors of nested containers on this process's device; copies to a GPU do not wait."""
        return moved(batch, self.device)


class StepLoss(nn.Module):
    """A step's forward pass: what is wrapped to average gradients over processes."""

    def __init__(self, task: Any) -> None:
        super().__init__()
        self.model = task.model
        self._loss = task.loss

    def forward(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """The task's terms."""
        return self._loss(batch, generator)


def moved(batch: Any, device: torch.device) -> Any:
    """Nested dictionaries and lists with their tensors on a device."""
    if isinstance(batch, Tensor):
        if device.type == "cuda" and not batch.is_cuda:
            return batch.pin_memory().to(device, non_blocking=True)
        return batch.detach().to(device)
    if isinstance(batch, dict):
        return {key: moved(value, device) for key, value in batch.items()}
    if isinstance(batch, list):
        return [moved(value, device) for value in batch]
    return batch


def choose_device(options: LoopOptions) -> torch.device:
    """Where to train: the kind of device, not yet which of several.

    Raises:
        ValueError: CUDA is asked for and absent.
    """
    if options.device == "cuda" and not torch.cuda.is_available():
        raise ValueError("loop.device is cuda, but this machine has no usable GPU")
    if options.device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    return torch.device(options.device)


def _accelerator(device: torch.device) -> Any:
    try:
        from accelerate import Accelerator, InitProcessGroupKwargs
        from accelerate.state import AcceleratorState, is_initialized
        from accelerate.utils import DistributedType
    except ImportError as error:
        raise RuntimeError(
            f"training needs accelerate ({error}); install it with: pip install 'freetalk[train]'"
        ) from None
    # accelerate keeps device and precision for the life of the interpreter; here each training has its own.
    if is_initialized():
        earlier = AcceleratorState()
        if earlier.num_processes == 1 and earlier.device.type != device.type:
            AcceleratorState._reset_state(reset_partial_state=True)
    accelerator = Accelerator(
        cpu=device.type == "cpu",
        mixed_precision="no",
        kwargs_handlers=[InitProcessGroupKwargs(timeout=_PATIENCE)],
    )
    known = (DistributedType.NO, DistributedType.MULTI_CPU, DistributedType.MULTI_GPU)
    if accelerator.distributed_type not in known:
        raise RuntimeError(
            f"accelerate is set up for {accelerator.distributed_type.value}; trainings here run with "
            "MULTI_GPU, MULTI_CPU or alone (see `accelerate config`)"
        )
    return accelerator
