"""Processes, devices, precision and states of a training, all run by Hugging Face accelerate.

Processes are those of ``torchrun`` or ``accelerate launch``; one process without either is the same code with
nothing to exchange.
"""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import torch
from torch import Tensor, nn

from freetalk.train.config import LoopOptions

#: How long processes wait for the one that prepares data.
_PATIENCE = timedelta(hours=12)


class Engine:
    """This process among those that train together.

    Attributes:
        accelerator: what computes, exchanges and saves.
        is_main: whether this process writes files and shows progress.
        device: where this process computes.
        rank: number of this process.
        num_processes: how many train together.
        batch_size: items of a step.
        shard_size: items of one forward pass of one process.

    Args:
        options: device, precision and batch size.

    Raises:
        ValueError: the device is absent or does not have the precision, or the batch does not divide.
        RuntimeError: accelerate is missing, or was configured for a way of training that this is not.
    """

    def __init__(self, options: LoopOptions) -> None:
        self.accelerator = _accelerator(options)
        self.is_main: bool = self.accelerator.is_main_process
        self.device: torch.device = self.accelerator.device
        self.rank: int = self.accelerator.process_index
        self.num_processes: int = self.accelerator.num_processes
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
        self.accelerator.register_save_state_pre_hook(_save_unwrapped)
        self.accelerator.register_load_state_pre_hook(_load_unwrapped)

    def use_device(self) -> None:
        """Makes the calling thread use this process's GPU."""
        if self.device.type == "cuda":
            torch.cuda.set_device(self.device)

    def prepare(
        self, module: nn.Module, optimizer: torch.optim.Optimizer, skips_layers: bool = False
    ) -> tuple[nn.Module, Any]:
        """The module in the options' precision that averages gradients over the processes, and its optimiser.

        Args:
            module: its forward pass is all that a backward pass sees.
            optimizer: of its parameters.
            skips_layers: whether a pass may leave parameters out (layer drop).
        """
        from accelerate import DistributedDataParallelKwargs

        settings = DistributedDataParallelKwargs(find_unused_parameters=skips_layers)
        self.accelerator.ddp_handler = settings
        prepared: nn.Module = self.accelerator.prepare_model(module)
        return prepared, self.accelerator.prepare_optimizer(optimizer)

    def keep(self, module: nn.Module) -> None:
        """Makes a module that is not trained part of the saved state."""
        self.accelerator.prepare_model(module, device_placement=False, evaluation_mode=True)

    @property
    def scale(self) -> float | None:
        """What fp16 gradients are multiplied by; ``None`` in other precisions."""
        scaler = self.accelerator.scaler
        return None if scaler is None else float(scaler.get_scale())

    def mean(self, values: Tensor) -> Tensor:
        """Mean over the processes, the same in each."""
        if self.num_processes == 1:
            return values
        return self.accelerator.reduce(values, reduction="mean")

    def joined(self, numbered: list[tuple[int, Any]]) -> list[Any]:
        """The numbered records of all processes in their order, in each."""
        from accelerate.utils import gather_object

        return [record for _, record in sorted(gather_object(numbered), key=lambda one: one[0])]


class StepLoss(nn.Module):
    """A step's forward pass: what is wrapped to average gradients over processes."""

    def __init__(self, task: Any) -> None:
        super().__init__()
        self.model = task.model
        self._loss = task.loss

    def forward(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """The task's terms."""
        return self._loss(batch, generator)


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


def _save_unwrapped(models: list[nn.Module], weights: list[Any], folder: str) -> None:
    """States are those of one process, whatever averages gradients around them."""
    from accelerate.utils import extract_model_from_parallel

    weights[:] = [extract_model_from_parallel(model).state_dict() for model in models]


def _load_unwrapped(models: list[nn.Module], folder: str) -> None:
    from accelerate.utils import extract_model_from_parallel

    models[:] = [extract_model_from_parallel(model) for model in models]


def _accelerator(options: LoopOptions) -> Any:
    device = choose_device(options)
    if options.fp16 and device.type == "cpu":
        raise ValueError("loop.fp16 needs a GPU; loop.bf16 runs on processors too")
    try:
        from accelerate import Accelerator, InitProcessGroupKwargs
        from accelerate.state import AcceleratorState, PartialState, is_initialized
        from accelerate.utils import DistributedType
    except ImportError as error:
        raise RuntimeError(
            f"training needs accelerate ({error}); install it with: pip install 'freetalk[train]'"
        ) from None
    # accelerate keeps device and precision for the life of the interpreter; here each training has its own.
    if is_initialized():
        alone = PartialState().num_processes == 1
        AcceleratorState._reset_state(reset_partial_state=alone)
    accelerator = Accelerator(
        cpu=device.type == "cpu",
        mixed_precision="bf16" if options.bf16 else "fp16" if options.fp16 else "no",
        kwargs_handlers=[InitProcessGroupKwargs(timeout=_PATIENCE)],
    )
    known = (DistributedType.NO, DistributedType.MULTI_CPU, DistributedType.MULTI_GPU)
    if accelerator.distributed_type not in known:
        raise RuntimeError(
            f"accelerate is set up for {accelerator.distributed_type.value}; trainings here run with "
            "MULTI_GPU, MULTI_CPU or alone (see `accelerate config`)"
        )
    return accelerator
