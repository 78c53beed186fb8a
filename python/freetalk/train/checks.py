"""What is looked at before the first step, so that nothing which a look would have told stops a night's training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from freetalk.data import DatasetError, MotionDataset, NotFiniteError
from freetalk.train.checkpoint import find_checkpoint, load_state
from freetalk.train.config import TrainingConfig

NO_VALIDATION = (
    "{} has no {} in its val split, which trainings validate on: name some in its labels.csv or "
    "splits.json"
)
#: Task options that do not change what is learnt.
_FREE = ("operator_cache", "feature_cache", "validation_windows", "validation_crops")
_NAMED = 10


def check_motion(corpus: MotionDataset, cache: Path) -> None:
    """Reads every frame that training and validation will; a note in `cache` spares the next start it.

    Raises:
        NotFiniteError: frames hold NaN or infinity, or cannot be read; names the first ten sequences.
    """
    note = cache / f"motion-read-{''.join(c if c.isalnum() else '-' for c in corpus.fingerprint)}"
    if note.is_file():
        return
    sequences = [*corpus.sequences("train"), *corpus.sequences("val")]
    wrong = []
    for sequence in tqdm(sequences, desc="motion", unit="take", leave=False):
        try:
            finite = np.isfinite(corpus.landmarks(sequence)).all(axis=(1, 2))
        except (DatasetError, OSError) as error:
            wrong.append(str(error))
            continue
        if not finite.all():
            frame = int(np.flatnonzero(~finite)[0])
            wrong.append(f"{sequence.id}, frame {frame} holds NaN or infinity")
    if wrong:
        raise NotFiniteError(
            f"{corpus.name}: {len(wrong)} of {len(sequences)} sequences cannot be trained on; mend them "
            f"or take them out: {'; '.join(wrong[:_NAMED])}"
        )
    cache.mkdir(parents=True, exist_ok=True)
    note.touch()


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
