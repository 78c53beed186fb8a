"""The one training loop: steps, weight average, validation, checkpoints, samples, progress.

Every random draw of step n is a function of (seed, n), so a run that was killed and continued walks the
same path as one that was not.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.optim.swa_utils import AveragedModel

from freetalk.train.checkpoint import continued_from, git_commit, save_checkpoint
from freetalk.train.config import LoopOptions, TrainingConfig
from freetalk.train.draws import Draws, step_seed
from freetalk.train.engine import Engine, StepLoss
from freetalk.train.previews import save_sample
from freetalk.train.progress import Progress, notice, stop_requests
from freetalk.train.task import Batch, Task, TrainingResult
from freetalk.train.weights import moving_average, parameter_groups

#: An fp16 scale below which gradients overflow whatever it is.
_SMALLEST_SCALE = 2.0**-14
#: Loader workers of a training on a GPU, where ``loop.workers`` is -1.
_WORKERS_OF_A_GPU = 4
#: Scores that are the better the higher they are have one of these in their name.
_HIGHER_IS_BETTER = ("correlation", "accuracy")


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
        skips = getattr(task, "skips_parameters", False)
        skips_layers = float(config.model.get("layerdrop", 0.0)) > 0 or skips
        self.module, self.optimizer = self.engine.prepare(
            StepLoss(task),
            torch.optim.AdamW(
                parameter_groups(task.model, self.options.weight_decay),
                lr=self.options.learning_rate,
                fused=True,
            ),
            skips_layers,
        )
        self.average: AveragedModel | None = None
        if self.options.ema_decay > 0:
            self.average = moving_average(task.model, self.options.ema_decay)
            self.engine.keep(self.average)
        self.step = 0
        self.elapsed_s = 0.0
        self.best = math.inf
        self.scores: dict[str, float] = {}
        self._names: list[str] = []  # of the terms
        self._unread: list[Tensor] = []  # terms of the last steps, on the device
        self._broken = torch.zeros(
            (), device=self.engine.device
        )  # 1 after a step that is not finite
        self._spent_s = 0.0  # in those steps, by this process
        self._read_at = 0
        self._asked_to_stop = False  # this process
        self._stop = False  # all of them
        self._saved_step = -1

    def run(self) -> TrainingResult:
        """Trains until the steps or the minutes are used up, or until told to stop."""
        if self._resume() and self._finished():
            return self._result("finished")
        self.task.model.train()
        progress = Progress(self.config, self.out, self.step, self.max_steps, self.engine.is_main)
        with stop_requests(self.request_stop), progress, self.draws() as draws:
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

    def draws(self) -> Draws:
        """What the steps from here on see."""
        workers = self.options.workers
        if workers < 0:
            workers = _WORKERS_OF_A_GPU if self.engine.device.type == "cuda" else 0
        return Draws(self.task, self.engine, self.options.seed, workers, self.step)

    def request_stop(self) -> bool:
        """Ends the run after the step in progress; whether that was asked for before."""
        before, self._asked_to_stop = self._asked_to_stop, True
        return before

    def advance(self, draws: Draws) -> dict[str, float]:
        """A step, and its terms once the device has finished it."""
        self._train_step(draws)
        return self._read(draws)

    def _loop(self, draws: Draws, progress: Progress) -> None:
        options = self.options
        while not self._stop and not self._finished():
            self._train_step(draws)
            logged = self._is_due(options.log_every)
            stops = [options.validate_every, options.checkpoint_every, options.render_every]
            if logged or self.step >= self._read_at or any(map(self._is_due, stops)):
                terms = self._read(draws)
                terms["learning_rate"] = self._learning_rate()
                progress.show(self.step, self.elapsed_s, self._progress(), terms, logged)
            if self._is_due(options.render_every):
                self._render(progress)
            if self._finished():
                break
            if self._is_due(options.validate_every):
                self._validate(progress)
                self._checkpoint()
            elif self._is_due(options.checkpoint_every):
                self._checkpoint()
        if self._unread:
            self._read(draws)

    def _train_step(self, draws: Draws) -> None:
        """Forward, backward and update, without waiting for the device."""
        began = time.perf_counter()
        batches = draws.take()
        for group in self.optimizer.param_groups:
            group["lr"] = self._learning_rate()
        self.optimizer.zero_grad(set_to_none=True)
        passes = [self._pass(draws, batches, number) for number in range(len(batches))]
        weights, limit = list(self.task.model.parameters()), self.options.grad_clip or math.inf
        norm = self.engine.accelerator.clip_grad_norm_(weights, limit)
        names = list(passes[0])
        if self._unread and names != self._names:  # a stage with other terms has begun
            self._read(draws)
        self._names = names
        means = [torch.stack([found[name] for found in passes]).mean() for name in self._names]
        found = torch.stack([*means, norm.detach()]).float()
        if not self.options.fp16:
            # AdamW leaves the weights as they are where this is 1: a bad step is told later, and none follows it.
            judged = found[[self._names.index("loss"), -1]]
            self._broken = torch.maximum(self._broken, (~judged.isfinite().all()).float())
            self.optimizer.optimizer.found_inf = self._broken
        self.optimizer.step()
        self.step += 1
        if self.average is not None:
            self.average.update_parameters(self.task.model)
        self._unread.append(found)
        self._spent_s += time.perf_counter() - began
        if self.engine.num_processes == 1:
            self._stop = self._asked_to_stop

    def _pass(self, draws: Draws, batches: list[Batch], number: int) -> dict[str, Tensor]:
        """Forward and backward of one of a step's batches; gradients add up to the step's mean."""
        generator = draws.generator(self.step, number)
        # Dropout draws globally.
        torch.manual_seed(step_seed(self.options.seed + 1, self.step, draws.shard(number)))
        accelerator, last = self.engine.accelerator, number == len(batches) - 1
        with nullcontext() if last else accelerator.no_sync(self.module):  # the last exchanges them
            terms: dict[str, Tensor] = self.module(batches[number], generator)
            accelerator.backward(terms["loss"] / len(batches))
        return {name: value.detach() for name, value in terms.items()}

    def _read(self, draws: Draws) -> dict[str, float]:
        """Waits for the device: terms of the last step, after a look at all that were not read.

        All processes read after the same steps, follow one clock and stop together.
        """
        began = time.perf_counter()
        found = torch.stack(self._unread)
        first = self.step - len(self._unread)
        rows = self.engine.mean(found).tolist()
        self._unread = []
        self._spent_s += time.perf_counter() - began
        names = [*self._names, "gradient_norm"]
        for at, row in enumerate(rows):
            if not self._is_sound(dict(zip(names, row))):
                self._fail(draws, first + at, dict(zip(names, row)))
        seconds, asked = self._agree(self._spent_s)
        self._stop = self._stop or asked
        self._spent_s = 0.0
        self.elapsed_s += seconds
        self._read_at = self.step + max(1, min(100, int(len(rows) / max(seconds, 1e-6))))
        return dict(zip(names, rows[-1]))

    def _agree(self, seconds: float) -> tuple[float, bool]:
        """Seconds since the last agreement by all processes' mean, and whether one was told to stop."""
        if self.engine.num_processes == 1:
            return seconds, self._asked_to_stop
        own = torch.tensor([seconds, float(self._asked_to_stop)], device=self.engine.device)
        mean, asked = self.engine.mean(own).tolist()
        return mean, asked > 0

    def _is_sound(self, found: dict[str, float]) -> bool:
        if not math.isfinite(found["loss"]):
            return False
        if self.options.fp16:  # the scaler skips overflowing steps and lowers the scale
            return (self.engine.scale or 0.0) > _SMALLEST_SCALE
        return math.isfinite(found["gradient_norm"])

    def _fail(self, draws: Draws, step: int, found: dict[str, float]) -> None:
        self.step = step  # the steps after it changed nothing
        batches = draws.again(step)
        rank = f"_{self.engine.rank}" if self.engine.rank else ""
        path = self.out / f"failed_batch_{self.config.kind}{rank}.pt"
        torch.save(batches[0] if len(batches) == 1 else batches, path)
        shown = ", ".join(f"{name} {value}" for name, value in found.items())
        raise RuntimeError(
            f"step {step} of {self.config.kind} is not finite ({shown}); its batch is saved as "
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
        trained = self.task.model
        self.task.model = trained if self.average is None else self.average.module
        self.task.model.eval()
        try:
            with torch.no_grad():
                yield
        finally:
            self.task.model = trained
            trained.train()

    def _validate(self, progress: Progress) -> None:
        """Scores the weights, each process its part, and exports them where they are the best."""
        began = time.perf_counter()
        with self._evaluating():
            part = self.task.validate(self.engine.rank, self.engine.num_processes)
            # Lips that never move have no correlation; JSON has no NaN, and C++ reads the scores.
            found = self.task.scores(self.engine.joined(part)).items()
            self.scores = {name: value for name, value in found if math.isfinite(value)}
            score = self._selected()
            if self.options.keep == "last" or score <= self.best:
                self.best = score
                if self.engine.is_main:
                    self.task.export(self.out / self.config.kind, self._training_record())
        if self.engine.is_main:
            progress.show_scores(self.step, self.scores, time.perf_counter() - began)

    def _selected(self) -> float:
        """The score that the best weights are chosen by, the smaller the better."""
        name = self.options.select
        if name not in self.scores:
            known = ", ".join(sorted(self.scores)) or "none"
            raise ValueError(
                f"loop.select={name} is no score of this validation; there are: {known}"
            )
        higher = any(word in name for word in _HIGHER_IS_BETTER)
        return -self.scores[name] if higher else self.scores[name]

    def _render(self, progress: Progress) -> None:
        draw = getattr(self.task, "sample", None)  # an encoder or a head has nothing that moves
        if self.engine.is_main and draw is not None:
            began = time.perf_counter()
            with self._evaluating():
                sample = draw()
            path = self.out / "samples" / self.config.kind / f"step_{self.step:07d}"
            picture = save_sample(sample, path)
            progress.show_picture(self.step, picture, time.perf_counter() - began)
        self.engine.accelerator.wait_for_everyone()

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
        self.engine.accelerator.wait_for_everyone()

    def _save(self, whole: bool) -> None:
        """Writes a checkpoint of the steps so far."""
        state = {
            "config": self.config.to_dict(),
            "data": self.data,
            "elapsed_s": self.elapsed_s,
            "best": self.best if math.isfinite(self.best) else None,
            "scores": self.scores,
            "finished": whole,
        }

        def write(folder: Path) -> None:
            self.engine.accelerator.save_state(str(folder / "state"))
            with self._evaluating():
                self.task.export(folder, self._training_record())

        save_checkpoint(self.checkpoints, self.step, state, write, self.options.keep_checkpoints)
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

    def _resume(self) -> bool:
        """Goes to where a checkpoint was; whether that was the end."""
        found = continued_from(self.checkpoints, self.config, self.data)
        if found is None:
            return False
        folder, state = found
        self.engine.accelerator.load_state(str(folder / "state"))
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
        size = sum(p.numel() for p in self.task.model.parameters())
        return TrainingResult(status, self.step, self.scores, self.out / self.config.kind, size)
