"""Checkpoints: a folder per saved step, swapped in whole; which training may go on from them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch import Tensor

from freetalk import _native
from freetalk._files import beside, flush, write_json
from freetalk.train.config import TrainingConfig

_POINTER = "last.json"
_VERSION = 4


def save_checkpoint(
    directory: Path,
    step: int,
    state: dict[str, Any],
    write: Callable[[Path], None],
    keep: int = 1,
) -> None:
    """Saves a step and forgets older ones; stopping at any moment leaves a whole one.

    A checkpoint is a folder: what `write` leaves there (``config.json`` with the options and
    ``model.safetensors``, which ``from_pretrained`` and C++ load, and ``state/`` to go on from), and
    ``state.json``.

    Args:
        directory: folder of the checkpoints.
        step: number of finished steps.
        state: JSON values.
        write: fills the folder.
        keep: checkpoints that stay, the newest.
    """
    directory.mkdir(parents=True, exist_ok=True)
    name = _unused_name(directory, step)
    temporary = beside(directory / name)
    temporary.mkdir()
    write(temporary)
    write_json(temporary / "state.json", {"version": _VERSION, "step": step, **state})
    for path in [*temporary.rglob("*"), temporary]:
        flush(path)
    temporary.replace(directory / name)
    write_json(directory / _POINTER, {"checkpoint": name})
    whole = sorted(directory.glob("step_*"), key=lambda path: (path.stat().st_mtime_ns, path.name))
    for old in [path for path in whole if path.name != name][: max(0, len(whole) - keep)]:
        shutil.rmtree(old, ignore_errors=True)
    for left in directory.glob(".step_*"):
        shutil.rmtree(left, ignore_errors=True)


def find_checkpoint(directory: Path) -> Path | None:
    """The newest whole checkpoint, or ``None``."""
    pointer = directory / _POINTER
    if not pointer.is_file():
        return None
    path = directory / str(json.loads(pointer.read_text())["checkpoint"])
    if not (path / "state.json").is_file():
        raise FileNotFoundError(
            f"{pointer} names {path.name}, which is missing; delete {directory} to start anew"
        )
    return path


def load_state(path: Path) -> dict[str, Any]:
    """The JSON values of a checkpoint.

    Raises:
        ValueError: another version of freetalk wrote it.
    """
    state: dict[str, Any] = json.loads((path / "state.json").read_text())
    if state.get("version") != _VERSION:
        raise ValueError(
            f"{path} is of another version of freetalk's training; finish it with that one, or start "
            f"anew from its weights (task.init) with another --out"
        )
    return state


def _unused_name(directory: Path, step: int) -> str:
    """A step that is saved again goes beside the folder that the pointer still names."""
    name, again = f"step_{step:07d}", 1
    while (directory / name).exists():
        again += 1
        name = f"step_{step:07d}_{again}"
    return name


def export_model(
    directory: Path,
    config: dict[str, Any],
    state: dict[str, Tensor],
    keep_float32: tuple[str, ...] = (),
) -> None:
    """Writes ``model.safetensors`` (float16) and ``config.json`` for inference.

    Args:
        directory: folder to write to.
        config: contents of config.json.
        state: tensors by name.
        keep_float32: tensors whose name starts with one of these keep full precision.
    """
    directory.mkdir(parents=True, exist_ok=True)
    halved: dict[str, Tensor] = {}
    for name, tensor in state.items():
        value = tensor.detach().cpu()
        whole = name.startswith(keep_float32)
        halved[name] = (
            value.half() if value.is_floating_point() and not whole else value.clone()
        ).contiguous()
    _native.core.save_model_files(os.fspath(directory), json.dumps(config), halved)


def git_commit() -> str:
    """Commit of the source tree that this package runs from, with ``+changes`` where files differ from it.

    An installed package has none: it answers ``unknown``, also inside of somebody else's repository.
    """

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", *arguments],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
        return done.stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)
        changes = git("status", "--porcelain", "--untracked-files=no")
        return git("rev-parse", "HEAD") + ("+changes" if changes else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


NO_VALIDATION = (
    "{} has no {} in its val split, which trainings validate on: name some in its labels.csv or "
    "splits.json"
)
#: Task options that do not change what is learnt.
_FREE = (
    *("operator_cache", "operator_memory_gb", "feature_cache"),
    *("validation_windows", "validation_samples", "validation_crops"),
)


def continued_from(
    checkpoints: Path, config: TrainingConfig, data: str
) -> tuple[Path, dict[str, Any]] | None:
    """The newest checkpoint of a training, which may go on from it, and its values; ``None`` without any.

    Args:
        checkpoints: folder of the checkpoints.
        config: of the training.
        data: fingerprint of its data.

    Raises:
        ValueError: the checkpoint is of another model, task or data; names the differences.
    """
    found = find_checkpoint(checkpoints)
    if found is None:
        return None
    state = load_state(found)
    differences = []
    now = config.to_dict()
    for part in ("model", "task"):
        then: dict[str, Any] = state["config"][part]
        names = [n for n in {**then, **now[part]} if n not in _FREE]
        differences += [
            f"{part}.{name} {then.get(name)} -> {now[part].get(name)}"
            for name in names
            if then.get(name) != now[part].get(name)
        ]
    if state["data"] != data:
        differences.append(f"the data {state['data']} -> {data}")
    if differences:
        raise ValueError(
            f"{found} is of another training ({'; '.join(differences)}); give another --out, or delete "
            f"{checkpoints} to start anew"
        )
    return found, state
