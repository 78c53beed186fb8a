"""The one training loop: steps, weight average, validation, checkpoints, samples, progress.

Every random draw of step n is a function of (seed, n), so a run that was killed and continued walks the
same path as one that was not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sized
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from freetalk.train.checkpoint import (
    find_checkpoint,
    git_commit,
    load_checkpoint,
    save_checkpoint,
)
from freetalk.train.checks import check_continues
from freetalk.train.config import LoopOptions, TrainingConfig
from freetalk.train.draws import Batch, Draws, DrawsItems, step_seed
from freetalk.train.engine import Engine, StepLoss, moved
from freetalk.train.interrupts import stop_requests
from freetalk.train.previews import ShowsSamples, save_sample
from freetalk.train.progress import Progress, notice
from freetalk.train.weights import Average, parameter_groups

#: An fp16 scale below which gradients overflow whatever it is.
_SMALLEST_SCALE = 2.0**-14


class Task(DrawsItems, Protocol):
    """What differs between the trainings."""

    @property
    def epochs(self) -> Sized | None:
        """The windows of an epoch, for ``loop.epochs``; ``None`` where the task has none."""

    @property
    def model(self) -> nn.Module:
        """What is trained."""

    def loss(self, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Scalar terms; ``loss`` is minimised."""

    def validate(self) -> dict[str, float]:
        """Scores of the current weights; ``score`` is the one to minimise."""

    def export(self, directory: Path, training: dict[str, Any]) -> None:
        """Writes the current weights for inference, with how they came to be."""


@dataclass(frozen=True)
class TrainingResult:
    """How a training ended: ``finished`` or ``interrupted``, after how many steps, with what scores.

    Attributes:
        directory: of the weights.
        parameters: that were trained.
        lacking: one sentence on what the output folder lacks to be a folder of weights; empty where it is one.
    """

    status: str
    step: int
    scores: dict[str, float]
    directory: Path
    parameters: int
    lacking: str = ""


class Trainer:
    """Runs a task under a configuration and writes everything below `out`.

    Args:
        task: what is trained.
        config: its configuration.
        out: folder to write to.
        data: fingerprint of the data: another does not go on from this one's checkpoints.
        command: what was typed, noted with the weights.
        engine: this process among those that train together.
    """

    def __init__(
        self,
        task: Task,
        config: TrainingConfig,
        out: Path,
        data: str,
        command: str = "",
        engine: Engine | None = None,
    ) -> None:
        self.task = task
        self.config = config
        self.options: LoopOptions = config.loop
        self.out = out
        self.data = data
        self.command = command
        self.max_steps = self._steps_in_all()
        self.engine = engine or Engine(config.loop)
        self.checkpoints = out / "checkpoints" / config.kind
        skips_layers = float(config.model.get("layerdrop", 0.0)) > 0
        self.module = self.engine.prepare(StepLoss(task), skips_layers)
        self.optimizer = torch.optim.AdamW(
            parameter_groups(task.model, self.options.weight_decay),
            lr=self.options.learning_rate,
            fused=True,
        )
        self.average = Average(task.model, self.options.ema_decay)
        self.step = 0
        self.elapsed_s = 0.0
        self.best = math.inf
        self.scores: dict[str, float] = {}
        self._asked_to_stop = False  # this process
        self._stop = False  # all of them
        self._saved_step = -1

    def run(self) -> TrainingResult:
        """Trains until the steps or the minutes are used up, or until told to stop."""
        if self._resume() and self._finished():
            return self._result("finished")
        self.task.model.train()
        progress = Progress(self.config, self.out, self.step, self.max_steps, self.engine.is_main)
        draws = Draws(self.task, self.engine, self.options.seed)
        with stop_requests(self.request_stop), progress, draws:
            try:
                self._loop(draws, progress)
            except Exception:
                self._save_after_failure()
                raise
            if not self._finished():
                self._checkpoint()
                self._say_how_to_go_on()
                return self._result("interrupted")
            self._validate(progress)
            self._checkpoint(whole=True)
        return self._result("finished")

    def request_stop(self) -> bool:
        """Ends the run after the step in progress; whether that was asked for before."""
        before, self._asked_to_stop = self._asked_to_stop, True
        return before

    def _loop(self, draws: Draws, progress: Progress) -> None:
        options = self.options
        while not self._stop and not self._finished():
            terms = self._train_step(draws)
            if self._is_due(options.log_every) or progress.is_due():
                terms["learning_rate"] = self._learning_rate()
                logged = self._is_due(options.log_every)
                progress.show(self.step, self.elapsed_s, self._progress(), terms, logged)
            if self._is_due(options.render_every):
                self._render(progress)
            if self._finished():
                return
            if self._is_due(options.validate_every):
                self._validate(progress)
                self._checkpoint()
            elif self._is_due(options.checkpoint_every):
                self._checkpoint()

    def _train_step(self, draws: Draws) -> dict[str, float]:
        began = time.perf_counter()
        batches = draws.take(self.step)
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate()
        self.optimizer.zero_grad(set_to_none=True)
        passes = [self._pass(draws, batches, number) for number in range(len(batches))]
        self.engine.scaler.unscale_(self.optimizer)
        norm = nn.utils.clip_grad_norm_(
            self.task.model.parameters(), self.options.grad_clip or math.inf
        )
        names = list(passes[0])
        means = [torch.stack([found[name] for found in passes]).mean() for name in names]
        shared = self.engine.mean(torch.stack([*means, norm.detach()]).float())
        found = dict(
            zip([*names, "gradient_norm"], shared.tolist())
        )  # the step's one wait for a GPU
        if not self._is_sound(found):
            self._fail(batches, passes, found)
        self.engine.scaler.step(self.optimizer)
        self.engine.scaler.update()
        self.step += 1
        self.average.update(self.task.model, self.step)
        self._agree(time.perf_counter() - began)
        return found

    def _pass(self, draws: Draws, batches: list[Batch], number: int) -> dict[str, Tensor]:
        """Forward and backward of one of a step's batches; gradients add up to the step's mean."""
        generator = draws.generator(self.step, number)
        # Dropout draws globally.
        torch.manual_seed(step_seed(self.options.seed + 1, self.step, draws.shard(number)))
        with self.engine.last_of_step(self.module, number == len(batches) - 1):
            with self.engine.autocast():
                terms: dict[str, Tensor] = self.module(batches[number], generator)
            scaled = self.engine.scaler.scale(terms["loss"] / len(batches))
            scaled.backward()  # type: ignore[no-untyped-call]
        return {name: value.detach() for name, value in terms.items()}

    def _agree(self, seconds: float) -> None:
        """All processes stop together and follow one clock."""
        if self.engine.num_processes > 1:
            own = torch.tensor([seconds, float(self._asked_to_stop)], device=self.engine.device)
            seconds, asked = self.engine.mean(own).tolist()
            self._stop = asked > 0
        else:
            self._stop = self._asked_to_stop
        self.elapsed_s += seconds

    def _is_sound(self, found: dict[str, float]) -> bool:
        if not math.isfinite(found["loss"]):
            return False
        if self.options.fp16:  # the scaler skips overflowing steps and lowers the scale
            return self.engine.scaler.get_scale() > _SMALLEST_SCALE
        return math.isfinite(found["gradient_norm"])

    def _fail(
        self, batches: list[Batch], passes: list[dict[str, Tensor]], found: dict[str, float]
    ) -> None:
        bad = [b for b, p in zip(batches, passes) if not torch.isfinite(p["loss"])] or batches
        rank = f"_{self.engine.rank}" if self.engine.rank else ""
        path = self.out / f"failed_batch_{self.config.kind}{rank}.pt"
        torch.save(moved(bad[0] if len(bad) == 1 else bad, torch.device("cpu")), path)
        shown = ", ".join(f"{name} {value}" for name, value in found.items())
        raise RuntimeError(
            f"step {self.step} of {self.config.kind} is not finite ({shown}); its batch is saved as "
            f"{path}. Lower loop.learning_rate or look at that batch"
        )

    def _steps_in_all(self) -> int:
        if not self.options.epochs:
            return self.options.max_steps
        if self.task.epochs is None:
            raise ValueError(f"{self.config.kind} draws crops at random: give loop.max_steps")
        return math.ceil(self.options.epochs * len(self.task.epochs) / self.options.batch_size)

    def _learning_rate(self) -> float:
        options = self.options
        rate = options.learning_rate * min(1.0, (self.step + 1) / max(options.warmup_steps, 1))
        if options.lr_schedule != "constant":
            by_clock = options.lr_schedule == "cosine_minutes"
            done = self._progress() if by_clock else self.step / self.max_steps
            cosine = 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
            rate *= options.lr_final + (1 - options.lr_final) * cosine
        return rate

    def _progress(self) -> float:
        minutes = self.options.max_minutes
        by_clock = self.elapsed_s / (60 * minutes) if minutes > 0 else 0.0
        return max(self.step / self.max_steps, by_clock)

    def _finished(self) -> bool:
        return self._progress() >= 1.0

    def _is_due(self, every: int) -> bool:
        return every > 0 and self.step > 0 and self.step % every == 0

    @contextmanager
    def _evaluating(self) -> Iterator[None]:
        """The averaged weights in eval mode, and no gradients."""
        model = self.task.model
        model.eval()
        averaged = self.average.applied(model) if self.average.weights else nullcontext()
        try:
            with averaged, torch.no_grad():
                yield
        finally:
            model.train()

    def _validate(self, progress: Progress) -> None:
        """Scores the weights and exports them where they are the best, on the main process."""
        if self.engine.is_main:
            began = time.perf_counter()
            with self._evaluating():
                # Lips that never move have no correlation; JSON has no NaN, and C++ reads the scores.
                found = self.task.validate().items()
                self.scores = {name: value for name, value in found if math.isfinite(value)}
                score = self.scores.get("score", math.inf)
                if self.options.keep == "last" or score <= self.best:
                    self.best = score
                    self.task.export(self.out / self.config.kind, self._training_record())
            progress.show_scores(self.step, self.scores, time.perf_counter() - began)
        self.scores = self.engine.from_main(self.scores)

    def _render(self, progress: Progress) -> None:
        if self.engine.is_main and isinstance(self.task, ShowsSamples):
            began = time.perf_counter()
            with self._evaluating():
                sample = self.task.sample()
            path = self.out / "samples" / self.config.kind / f"step_{self.step:07d}"
            picture = save_sample(sample, path)
            progress.show_picture(self.step, picture, time.perf_counter() - began)
        self.engine.from_main(None)

    def _training_record(self) -> dict[str, Any]:
        return {
            "config": self.config.to_dict(),
            "seed": self.options.seed,
            "command": self.command,
            "commit": git_commit(),
            "data_fingerprint": self.data,
            "steps": self.step,
            "minutes": round(self.elapsed_s / 60, 2),
            "processes": self.engine.num_processes,
            "torch": torch.__version__,
            "validation": self.scores,
        }

    def _checkpoint(self, whole: bool = False) -> None:
        """Saves what the training goes on from; `whole` where nothing is left to do."""
        if self.engine.is_main and self._saved_step != self.step:
            self._save(whole)
        self.engine.from_main(None)

    def _save(self, whole: bool) -> None:
        """Writes a checkpoint of the steps so far."""
        tensors = {"training": dict(self.task.model.state_dict())}
        if self.average.weights:
            tensors["average"] = self.average.weights
        optimizer = {"adamw": self.optimizer.state_dict()}
        if self.options.fp16:
            optimizer["scaler"] = self.engine.scaler.state_dict()
        state = {
            "config": self.config.to_dict(),
            "data": self.data,
            "elapsed_s": self.elapsed_s,
            "best": self.best if math.isfinite(self.best) else None,
            "scores": self.scores,
            "finished": whole,
        }
        save_checkpoint(
            self.checkpoints,
            self.step,
            tensors,
            optimizer,
            state,
            self._export,
            self.options.keep_checkpoints,
        )
        self._saved_step = self.step

    def _save_after_failure(self) -> None:
        """Keeps the steps before an error; nobody waits for the other processes, which may have died of it."""
        if not self.engine.is_main or self._saved_step == self.step or self.step == 0:
            return
        try:
            self._save(whole=False)
            self._say_how_to_go_on()
        except Exception as error:  # the first error is the one to tell
            notice(f"the {self.step} steps before could not be saved: {error}")

    def _export(self, directory: Path) -> None:
        with self._evaluating():
            self.task.export(directory, self._training_record())

    def _resume(self) -> bool:
        """Goes to where a checkpoint was; whether that was the end."""
        check_continues(self.checkpoints, self.config, self.data)
        found = find_checkpoint(self.checkpoints)
        if found is None:
            return False
        tensors, optimizer, state = load_checkpoint(found)
        self.task.model.load_state_dict(tensors["training"])
        if self.options.ema_decay > 0:
            self.average = Average(self.task.model, self.options.ema_decay)
            for name, value in tensors.get("average", {}).items():
                self.average.weights[name].copy_(value)
        self.optimizer.load_state_dict(optimizer["adamw"])
        if self.options.fp16 and "scaler" in optimizer:
            self.engine.scaler.load_state_dict(optimizer["scaler"])
        self.step = int(state["step"])
        self.elapsed_s = float(state["elapsed_s"])
        self.best = math.inf if state["best"] is None else float(state["best"])
        self.scores = state["scores"]
        self._saved_step = self.step
        notice(f"continuing {self.out} after step {self.step}")
        return bool(state["finished"])

    def _say_how_to_go_on(self) -> None:
        notice(
            f"stopped after step {self.step} and saved; the same command continues from there "
            f"({self.checkpoints})"
        )

    def _result(self, status: str) -> TrainingResult:
        parameters = sum(p.numel() for p in self.task.model.parameters())
        directory = self.out / self.config.kind
        return TrainingResult(status, self.step, self.scores, directory, parameters)
