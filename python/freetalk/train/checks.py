"""What is looked at before the first step, so that nothing which a look would have told stops a night's training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from freetalk.train.checkpoint import find_checkpoint, load_state
from freetalk.train.config import TrainingConfig

NO_VALIDATION = (
    "{} has no {} in its val split, which trainings validate on: name some in its labels.csv or "
    "splits.json"
)
#: Task options that do not change what is learnt.
_FREE = (
    *("operator_cache", "operator_memory_gb", "feature_cache"),
    *("validation_windows", "validation_samples", "validation_crops"),
)


def check_continues(checkpoints: Path, config: TrainingConfig, data: str) -> None:
    """Whether a training may go on from what its output folder holds.

    Args:
        checkpoints: folder of the checkpoints; an empty or absent one allows everything.
        config: of the training.
        data: fingerprint of its data.

    Raises:
        ValueError: the checkpoint is of another model, task or data; names the differences.
    """
    found = find_checkpoint(checkpoints)
    if found is None:
        return
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
