"""The one training loop: steps, weight average, validation, checkpoints, progress.

Every random draw of step n is a function of (seed, n), so a run that was killed and continued walks the
same path as one that was not.
"""

from __future__ import annotations

import math
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from freetalk.train.checkpoint import (
    find_checkpoint,
    git_commit,
    load_checkpoint,
    save_checkpoint,
    write_json,
)
from freetalk.train.config import LoopOptions, TrainingConfig

Batch = dict[str, Any]


class Task(Protocol):
    """What differs between the trainings."""

    @property
    def model(self) -> nn.Module:
        """What is trained."""

    def batch(self, generator: torch.Generator) -> Batch:
        """Draws the inputs of one step."""

    def loss(self, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Scalar terms; ``loss`` is minimised."""

    def validate(self) -> dict[str, float]:
        """Scores of the current weights; ``score`` is the one to minimise."""

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Writes the current weights for inference, with how they came to be."""


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended: ``finished`` or ``interrupted``, after how many steps, with what scores."""

    status: str
    step: int
    scores: dict[str, float]
    directory: Path


class Average:
    """Exponential moving average of weights; the decay rises from 0 so that early steps are forgotten."""

    def __init__(self, model: nn.Module, decay: float) -> None:
        self.decay = decay
        self.weights = {name: p.detach().clone() for name, p in model.named_parameters()}

    @torch.no_grad()
    def update(self, model: nn.Module, step: int) -> None:
        """Moves the average towards the weights after `step` steps."""
        decay = min(self.decay, (1 + step) / (10 + step))
        for name, parameter in model.named_parameters():
            self.weights[name].lerp_(parameter, 1 - decay)

    @contextmanager
    @torch.no_grad()
    def applied(self, model: nn.Module) -> Iterator[None]:
        """Puts the average into the model for the duration."""
        own = {name: p.detach().clone() for name, p in model.named_parameters()}
        self._copy(model, self.weights)
        try:
            yield
        finally:
            self._copy(model, own)

    @torch.no_grad()
    def _copy(self, model: nn.Module, weights: dict[str, Tensor]) -> None:
        for name, parameter in model.named_parameters():
            parameter.copy_(weights[name])


class Trainer:
    """Runs a task under a configuration and writes everything below `out`.

    Args:
        task: what is trained.
        config: its configuration.
        out: folder to write to.
        command: what was typed, noted with the weights.
    """

    def __init__(self, task: Task, config: TrainingConfig, out: Path, command: str = "") -> None:
        self.task = task
        self.config = config
        self.options: LoopOptions = config.loop
        self.out = out
        self.command = command
        self.checkpoints = out / "checkpoints" / config.kind
        decay_groups = parameter_groups(task.model, self.options.weight_decay)
        self.optimizer = torch.optim.AdamW(decay_groups, lr=self.options.learning_rate)
        self.average = Average(task.model, self.options.ema_decay)
        self.step = 0
        self.elapsed_s = 0.0
        self.best = math.inf
        self.scores: dict[str, float] = {}
        self._stop = False

    def run(self) -> TrainingResult:
        """Trains until the steps or the minutes are used up, or until told to stop."""
        self._resume()
        self.out.mkdir(parents=True, exist_ok=True)
        writer = SummaryWriter(
            str(self.out / "tensorboard" / self.config.kind), purge_step=self.step
        )
        self.task.model.train()
        with _stop_requests(self), writer:
            bar = tqdm(
                total=self.options.max_steps,
                initial=self.step,
                desc=self.config.kind,
                unit="step",
                dynamic_ncols=True,
                mininterval=1.0,
            )
            with bar:
                self._loop(bar, writer)
            if self._stop:
                self._checkpoint()
                return self._interrupted()
            if not self._is_due(self.options.validate_every):
                self._validate(writer)
            self._checkpoint()
        return TrainingResult("finished", self.step, self.scores, self.out / self.config.kind)

    def _loop(self, bar: tqdm[Any], writer: SummaryWriter) -> None:
        while not self._stop and not self._finished():
            began = time.perf_counter()
            terms = self._train_step()
            self.elapsed_s += time.perf_counter() - began
            bar.update(1)
            if self._is_due(self.options.log_every):
                for name, value in terms.items():
                    writer.add_scalar(f"train/{name}", value, self.step)
                writer.add_scalar("train/learning_rate", self._learning_rate(), self.step)
                rate = self.step * self.options.batch_size / max(self.elapsed_s, 1e-9)
                writer.add_scalar("train/items_per_second", rate, self.step)
                left = f"{self.elapsed_s / 60:.1f}"
                if self.options.max_minutes:
                    left += f"/{self.options.max_minutes:g}"
                bar.set_postfix_str(f"loss {terms['loss']:.4g}, {rate:.1f} items/s, {left} min")
            if self._is_due(self.options.validate_every):
                self._validate(writer)
                self._checkpoint()
            elif self._is_due(self.options.checkpoint_every):
                self._checkpoint()

    def _train_step(self) -> dict[str, float]:
        generator = torch.Generator().manual_seed(step_seed(self.options.seed, self.step))
        torch.manual_seed(step_seed(self.options.seed + 1, self.step))  # dropout draws globally
        batch = self.task.batch(generator)
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate()
        device = next(self.task.model.parameters()).device.type
        with torch.autocast(device, dtype=torch.bfloat16, enabled=self.options.bf16):
            terms = self.task.loss(batch, generator)
        self.optimizer.zero_grad(set_to_none=True)
        terms["loss"].backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(
            self.task.model.parameters(), self.options.grad_clip or math.inf
        )
        if not torch.isfinite(terms["loss"]) or not torch.isfinite(norm):
            self._fail(batch, terms, norm)
        self.optimizer.step()
        self.step += 1
        self.average.update(self.task.model, self.step)
        return {name: float(value.detach()) for name, value in terms.items()} | {
            "gradient_norm": float(norm)
        }

    def _fail(self, batch: Batch, terms: dict[str, Tensor], norm: Tensor) -> None:
        path = self.out / f"failed_batch_{self.config.kind}.pt"
        torch.save(batch, path)
        found = ", ".join(f"{name} {float(value.detach())}" for name, value in terms.items())
        raise RuntimeError(
            f"step {self.step} of {self.config.kind} is not finite ({found}, gradient norm "
            f"{float(norm)}); its batch is saved as {path}. Lower loop.learning_rate or look at "
            "that batch"
        )

    def _learning_rate(self) -> float:
        options = self.options
        rate = options.learning_rate * min(1.0, (self.step + 1) / max(options.warmup_steps, 1))
        if options.lr_schedule == "cosine":
            cosine = 0.5 * (1 + math.cos(math.pi * min(self._progress(), 1.0)))
            rate *= options.lr_final + (1 - options.lr_final) * cosine
        return rate

    def _progress(self) -> float:
        minutes = self.options.max_minutes
        by_clock = self.elapsed_s / (60 * minutes) if minutes > 0 else 0.0
        return max(self.step / self.options.max_steps, by_clock)

    def _finished(self) -> bool:
        return self._progress() >= 1.0

    def _is_due(self, every: int) -> bool:
        return every > 0 and self.step > 0 and self.step % every == 0

    def _validate(self, writer: SummaryWriter) -> None:
        began = time.perf_counter()
        self.task.model.eval()
        averaged = self.options.ema_decay > 0
        try:
            with self.average.applied(self.task.model) if averaged else _nothing():
                with torch.no_grad():
                    self.scores = self.task.validate()
                if self.options.keep == "last" or self.scores["score"] <= self.best:
                    self.best = self.scores["score"]
                    self.task.export(self.out / self.config.kind, self._training_record())
        finally:
            self.task.model.train()
        for name, value in self.scores.items():
            writer.add_scalar(f"val/{name}", value, self.step)
        shown = ", ".join(f"{name} {value:.4g}" for name, value in self.scores.items())
        seconds = time.perf_counter() - began
        tqdm.write(f"step {self.step}: {shown} ({seconds:.1f} s)", file=sys.stderr)

    def _training_record(self) -> dict[str, Any]:
        return {
            "config": self.config.to_dict(),
            "seed": self.options.seed,
            "command": self.command,
            "commit": git_commit(),
            "steps": self.step,
            "minutes": round(self.elapsed_s / 60, 2),
            "torch": torch.__version__,
            "validation": self.scores,
        }

    def _checkpoint(self) -> None:
        tensors = {"model": dict(self.task.model.state_dict()), "average": self.average.weights}
        state = {
            "config": self.config.to_dict(),
            "elapsed_s": self.elapsed_s,
            "best": self.best if math.isfinite(self.best) else None,
            "scores": self.scores,
        }
        save_checkpoint(self.checkpoints, self.step, tensors, self.optimizer.state_dict(), state)

    def _resume(self) -> None:
        found = find_checkpoint(self.checkpoints)
        if found is None:
            return
        tensors, optimizer, state = load_checkpoint(found)
        if state["config"]["model"] != self.config.to_dict()["model"]:
            raise ValueError(
                f"{found} was trained with other model options; give another --out or delete "
                f"{self.checkpoints}"
            )
        self.task.model.load_state_dict(tensors["model"])
        device = next(self.task.model.parameters()).device
        self.average.weights = {key: value.to(device) for key, value in tensors["average"].items()}
        self.optimizer.load_state_dict(optimizer)
        self.step = int(state["step"])
        self.elapsed_s = float(state["elapsed_s"])
        self.best = math.inf if state["best"] is None else float(state["best"])
        self.scores = state["scores"]
        tqdm.write(f"continuing {self.out} after step {self.step}", file=sys.stderr)

    def _interrupted(self) -> TrainingResult:
        tqdm.write(
            f"stopped after step {self.step} and saved; the same command continues from there "
            f"({self.checkpoints})",
            file=sys.stderr,
        )
        return TrainingResult("interrupted", self.step, self.scores, self.out / self.config.kind)

    def request_stop(self) -> None:
        """Ends the run after the step in progress."""
        self._stop = True


def parameter_groups(model: nn.Module, weight_decay: float) -> list[dict[str, Any]]:
    """Decay for matrices and kernels; none for biases, norms, diffusion times and tables."""
    decayed: list[nn.Parameter] = []
    spared: list[nn.Parameter] = []
    for name, parameter in model.named_parameters():
        table = any(part in name for part in ("position", "embedding", "diffusion_time"))
        (spared if parameter.ndim < 2 or table else decayed).append(parameter)
    groups = [
        {"params": decayed, "weight_decay": weight_decay},
        {"params": spared, "weight_decay": 0.0},
    ]
    return [group for group in groups if group["params"]]


def step_seed(seed: int, step: int) -> int:
    """A seed for one step: neighbours in seed or step share nothing (splitmix64)."""
    mask = (1 << 64) - 1
    value = (seed * 0x9E3779B97F4A7C15 + step * 0xD1342543DE82EF95 + 0x2545F4914F6CDD1D) & mask
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & mask
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & mask
    return (value ^ (value >> 31)) >> 1


@contextmanager
def _nothing() -> Iterator[None]:
    yield


@contextmanager
def _stop_requests(trainer: Trainer) -> Iterator[None]:
    """The first Ctrl-C (or SIGTERM) ends after the step, the second at once."""

    def handle(number: int, frame: FrameType | None) -> None:
        if trainer._stop:
            raise KeyboardInterrupt
        trainer.request_stop()
        tqdm.write("stopping after this step; once more to stop at once", file=sys.stderr)

    try:
        before = {s: signal.signal(s, handle) for s in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # signals belong to the main thread
        before = {}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def write_run_record(out: Path, config: TrainingConfig, data: Path) -> None:
    """Notes beside the weights what was asked for."""
    out.mkdir(parents=True, exist_ok=True)
    record = {"config": config.to_dict(), "data": str(data), "commit": git_commit()}
    write_json(out / f"run_{config.kind}.json", record)
