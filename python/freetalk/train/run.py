"""Entry point of every training."""

from __future__ import annotations

import ctypes
import importlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from freetalk._files import write_json
from freetalk.data import Dataset, open_datasets
from freetalk.train.assemble import assemble
from freetalk.train.checkpoint import continued_from, git_commit
from freetalk.train.config import TrainingConfig, load_config
from freetalk.train.engine import Engine
from freetalk.train.initial import start_from
from freetalk.train.loop import Trainer
from freetalk.train.progress import is_main_process
from freetalk.train.task import Task, TrainingResult
from freetalk.viz import check_video_support

_TASKS = {
    "ats": ("ats", "AtsTask"),
    "facetalk": ("facetalk", "FaceTalkTask"),
    "stm": ("stm", "StmTask"),
    "head": ("head", "HeadTask"),
    "speech": ("speech", "SpeechTask"),
}
# glibc's malloc.h, and the largest value that mallopt takes.
_M_TRIM_THRESHOLD, _M_MMAP_MAX, _MOST = -1, -4, 2**31 - 1


def run(
    kind: str,
    config_path: str | Path,
    overrides: list[str],
    data: str | Path | Sequence[str | Path],
    out: str | Path,
) -> TrainingResult:
    """Trains a model; an interrupted run continues when called again with the same `out`.

    Writes below `out`: ``<kind>/`` (weights for inference, after every validation that improves),
    ``checkpoints/<kind>/``, ``tensorboard/<kind>/``, ``samples/<kind>/``, ``run_<kind>.json``; once all stages are
    there also ``talker.json``: `out` is then a folder of weights for ``Talker.from_pretrained``. Under
    ``torchrun`` or ``accelerate launch`` every process calls it, with the same arguments; `data` and
    `out` are folders that all of them see.

    Args:
        kind: ``ats``, ``stm``, ``speech``, ``facetalk`` or ``head``.
        config_path: YAML file with sections ``model``, ``loop`` and ``task``.
        overrides: ``section.key=value`` pairs that win over the file.
        data: folder of the data, or several as ``NAME=PATH`` (see ``freetalk.data.open_datasets``).
        out: folder to write to.

    Returns:
        How it ended.

    Raises:
        ValueError: the configuration or the data is wrong.
        FileNotFoundError: a file is missing.
        RuntimeError: the loss or a gradient is not finite.
    """
    config = load_config(kind, config_path, overrides)
    command = f"freetalk train {kind} --config {Path(config_path).name} --data CORPUS --out OUT"
    given = [str(data)] if isinstance(data, str | Path) else [str(one) for one in data]
    command = " ".join([command, *overrides])
    result = train_dataset(config, lambda: open_datasets(data), Path(out), command, given)
    return replace(result, lacking=assemble(Path(out))) if is_main_process() else result


def train_dataset(
    config: TrainingConfig,
    dataset: Callable[[], Dataset],
    out: Path,
    command: str,
    data: Sequence[str] = (),
) -> TrainingResult:
    """Trains a model of a configuration, see :func:`run`.

    Args:
        config: what is trained, and how.
        dataset: opens what it is trained on; the main process does so first.
        out: folder to write to.
        command: what led here, noted with the weights.
        data: where the data lies, noted likewise.
    """
    engine = Engine(config.loop)
    if config.loop.threads > 0:
        torch.set_num_threads(config.loop.threads)
    if engine.device.type == "cpu":
        _keep_memory()
    if config.loop.render_every > 0 and engine.is_main:
        check_video_support()
    with engine.accelerator.main_process_first():
        corpus = dataset()
        continued_from(out / "checkpoints" / config.kind, config, corpus.fingerprint)
        task = make_task(config, corpus, out, engine.device)
    trainer = Trainer(task, config, out, corpus.fingerprint, command, engine)
    if engine.is_main:
        _write_run_record(out, config, data, corpus)
    return trainer.run()


def _keep_memory() -> None:
    """Lets glibc keep the large buffers that a step frees.

    As it is, they go back to the system, which gives each page of the next step's anew: half of the time of some
    trainings. Elsewhere nothing changes.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, _MOST)


def make_task(config: TrainingConfig, corpus: Dataset, out: Path, device: torch.device) -> Task:
    """The task of a configuration's kind, its model on `device` with its initial weights.

    Raises:
        ValueError: the data is not what the task needs.
    """
    torch.manual_seed(config.loop.seed)  # initial weights
    module, name = _TASKS[config.kind]  # each training imports only the rooms it needs
    make = getattr(importlib.import_module(f"freetalk.train.{module}"), name)
    task: Task = make(config, corpus, out, device)
    if config.task.init:
        start_from(task.model, config.task.init, config.kind)
    return task


def _write_run_record(
    out: Path, config: TrainingConfig, data: Sequence[str], corpus: Dataset
) -> None:
    """Notes beside the weights what was asked for, and what the data says of itself."""
    record = {
        "config": config.to_dict(),
        "data": list(data),
        "datasets": corpus.describe(),
        "data_fingerprint": corpus.fingerprint,
        "commit": git_commit(),
    }
    write_json(out / f"run_{config.kind}.json", record)
