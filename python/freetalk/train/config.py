"""Training configuration: YAML, overridden by ``key=value``, checked before anything starts."""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from freetalk.train.curves import LOGGERS
from freetalk.train.head_options import HeadTaskOptions
from freetalk.train.task_options import (
    AtsTaskOptions,
    FaceTalkTaskOptions,
    SpeechTaskOptions,
    StmTaskOptions,
    require,
    require_known,
    require_none_negative,
    require_positive,
)


@dataclass
class LoopOptions:
    """How long, how fast and on what a model trains.

    Attributes:
        seed: every random draw is a function of this and the step number.
        threads: CPU threads; 0 keeps torch's own choice.
        device: ``auto`` (CUDA where present), ``cpu`` or ``cuda``.
        batch_size: items a step (windows, crops or faces), over all processes and accumulated
            passes; a multiple of their number.
        accumulation_steps: forward passes that a step's items are shared out to, for what does not
            fit into memory at once.
        max_steps: optimiser steps.
        epochs: passes over the training windows, each of which shows every frame once, in place of
            ``max_steps`` and of random draws; 0 for none.
        max_minutes: training time after which it ends, 0 for no limit.
        learning_rate: AdamW's, at its peak.
        weight_decay: of matrices and kernels; biases, norms and embeddings are spared.
        lr_schedule: ``cosine`` over the steps to ``lr_final`` times the peak, ``cosine_minutes``
            (over the steps or ``max_minutes``, whichever is ahead: another machine then takes another
            path), or ``constant``.
        lr_final: end of the cosine relative to the peak.
        warmup_steps: linear rise of the learning rate.
        grad_clip: largest gradient norm, 0 disables.
        ema_decay: of the weight average that is validated and exported, 0 disables.
        bf16: run the networks under bfloat16 autocast.
        fp16: run them under float16 autocast with scaled gradients, for GPUs without bfloat16.
        workers: processes of each training process that draw its items ahead; 0 draws in a thread; -1
            takes 4 on a GPU, else 0.
        loggers: where curves go: ``tensorboard`` (``OUT/tensorboard``), ``csv`` (``OUT/curves``), ``wandb``.
        log_every: steps between points of the curves.
        validate_every: steps between validations (and exports), 0 only at the end.
        checkpoint_every: steps between checkpoints, 0 only at validations and at the end.
        keep: export the ``best`` validated weights or the ``last``.
        select: the validation's score that the best are chosen by, such as ``sampled_lve_mm2``; of correlations
            and accuracies the highest, of others the lowest.
        keep_checkpoints: newest checkpoints that stay.
        render_every: steps between rendered samples (a video in ``OUT/samples`` and a picture in
            TensorBoard or W&B), 0 for none.
    """

    seed: int = 0
    threads: int = 0
    device: str = "auto"
    batch_size: int = 16
    accumulation_steps: int = 1
    max_steps: int = 100_000
    epochs: int = 0
    max_minutes: float = 0.0
    learning_rate: float = 1e-4
    weight_decay: float = 1e-2
    lr_schedule: str = "constant"
    lr_final: float = 0.02
    warmup_steps: int = 0
    grad_clip: float = 1.0
    ema_decay: float = 0.0
    bf16: bool = False
    fp16: bool = False
    workers: int = -1
    loggers: list[str] = field(default_factory=lambda: ["tensorboard"])
    log_every: int = 10
    validate_every: int = 1000
    checkpoint_every: int = 500
    keep: str = "best"
    select: str = "score"
    keep_checkpoints: int = 1
    render_every: int = 0

    def check(self) -> None:
        """Raises ValueError where a value is out of range."""
        positive = ("batch_size", "accumulation_steps", "keep_checkpoints", "max_steps")
        require_positive(self, *positive, "learning_rate", section="loop")
        require_none_negative(self, "seed", "epochs", section="loop")
        require_known(self, "lr_schedule", "cosine", "cosine_minutes", "constant", section="loop")
        require_known(self, "device", "auto", "cpu", "cuda", section="loop")
        require_known(self, "keep", "best", "last", section="loop")
        for one in self.loggers:
            require(one in LOGGERS, f"loop.loggers must be of {', '.join(LOGGERS)}", one)
        require(
            self.lr_schedule != "cosine_minutes" or self.max_minutes > 0,
            "loop.lr_schedule cosine_minutes needs loop.max_minutes",
            self.max_minutes,
        )
        require(0 <= self.ema_decay < 1, "loop.ema_decay must be in [0, 1)", self.ema_decay)
        require(not (self.bf16 and self.fp16), "loop.bf16 and loop.fp16 exclude each other", "both")


TaskOptions = (
    AtsTaskOptions | StmTaskOptions | SpeechTaskOptions | FaceTalkTaskOptions | HeadTaskOptions
)
_TASKS: dict[str, type[Any]] = {
    "ats": AtsTaskOptions,
    "stm": StmTaskOptions,
    "speech": SpeechTaskOptions,
    "facetalk": FaceTalkTaskOptions,
    "head": HeadTaskOptions,
}
KINDS = tuple(_TASKS)


@dataclass
class TrainingConfig:
    """A checked configuration; ``model`` is checked by the model's own options."""

    kind: str
    model: dict[str, Any]
    loop: LoopOptions
    task: TaskOptions

    def to_dict(self) -> dict[str, Any]:
        """Plain containers, as stored beside the weights."""
        return dataclasses.asdict(self)


def find_config(path: str | Path) -> Path:
    """The file at ``path``, or the shipped configuration of that name.

    Raises:
        FileNotFoundError: neither exists; the message lists the shipped names.
    """
    if Path(path).is_file():
        return Path(path)
    package = Path(__file__).resolve().parents[1]
    shipped = {
        file.stem: file
        for folder in (package.parents[1] / "configs", package / "configs")
        for file in sorted(folder.glob("*.yaml"))
    }
    if str(path) not in shipped:
        names = ", ".join(sorted(shipped))
        raise FileNotFoundError(f"no configuration file {path}; shipped configurations: {names}")
    return shipped[str(path)]


def load_config(kind: str, path: str | Path, overrides: list[str] | None = None) -> TrainingConfig:
    """Reads a YAML file with sections ``model``, ``loop`` and ``task``.

    Args:
        kind: ``ats``, ``stm``, ``speech``, ``facetalk`` or ``head``.
        path: YAML file, or the name of a shipped one (``ats_small``).
        overrides: ``section.key=value`` pairs that win over the file; a mapping (``{a: 1}``) takes the
            place of the file's.

    Raises:
        ValueError: unknown kind or key (names the nearest), malformed value.
        FileNotFoundError: no such file.
    """
    if kind not in _TASKS:
        raise ValueError(f"unknown training {kind!r}; known: {', '.join(KINDS)}")
    path = find_config(path)
    try:
        base = OmegaConf.load(path)
        for override in overrides or []:
            option, _, value = override.partition("=")
            if value.strip().startswith("{") or value.strip() == "null":
                OmegaConf.update(base, option, None, merge=False)
        merged = OmegaConf.merge(base, OmegaConf.from_dotlist(overrides or []))
        raw = OmegaConf.to_container(merged, resolve=True)
    except (OmegaConfBaseException, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not isinstance(raw, dict):
        raise ValueError(f"{path} holds no sections model, loop, task")
    for key in raw:
        if key not in ("model", "loop", "task"):
            raise ValueError(_unknown(str(key), ["model", "loop", "task"], str(path)))
    model = {str(key): value for key, value in (raw.get("model") or {}).items()}
    loop = options_from_dict(LoopOptions, raw.get("loop") or {}, f"{path}: loop")
    task: TaskOptions = options_from_dict(_TASKS[kind], raw.get("task") or {}, f"{path}: task")
    loop.check()
    task.check()
    require(
        not (loop.epochs and task.source_weights),
        "loop.epochs shows everything once, which shares of sources contradict: leave one out; "
        "task.source_weights",
        task.source_weights,
    )
    return TrainingConfig(kind=kind, model=model, loop=loop, task=task)


T = TypeVar("T")


def options_from_dict(kind: type[T], values: dict[Any, Any], where: str) -> T:
    """Fills a dataclass of options; a value that is none of its field's type is a ValueError."""
    types = {f.name: f.type for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for key in values:
        if key not in types:
            raise ValueError(_unknown(str(key), list(types), where))
    given = {key: value for key, value in values.items() if value is not None}
    try:
        filled: Any = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(kind), given))
    except OmegaConfBaseException as error:
        name = str(error.full_key).split(".")[0].split("[")[0]
        raise ValueError(f"{where}.{name} = {values[name]!r} is no {types[name]}") from error
    return filled


def _unknown(key: str, known: list[str], where: str) -> str:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return f"{where}: unknown option {key!r}{hint}"
