"""One training of a table: known by a hash of all that decides its weights, so that rows and tables share it."""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from freetalk._files import content_hash, write_json
from freetalk.tables.scoring import encoder_folder
from freetalk.tables.sets import Catalogue
from freetalk.tables.views import ViewOptions
from freetalk.train.checkpoint import git_commit
from freetalk.train.config import load_config
from freetalk.train.run import train_dataset
from freetalk.train.task_options import DenoisingTaskOptions


@dataclass(frozen=True)
class Training:
    """What is trained, on what.

    Attributes:
        kind: ``ats``, ``stm`` or ``facetalk``.
        sets: names of the datasets.
        view: what of them.
        config: name or path of the configuration.
        overrides: ``section.key=value`` on top of it.
    """

    kind: str
    sets: tuple[str, ...]
    view: ViewOptions
    config: str
    overrides: tuple[str, ...] = ()

    def key(self, catalogue: Catalogue) -> str:
        """Hash of the configuration, the data and the speech encoder's weights."""
        config = load_config(self.kind, self.config, list(self.overrides))
        data = catalogue.mixture(self.sets, self.view).fingerprint
        task = config.task
        encoder = ""
        if isinstance(task, DenoisingTaskOptions):
            encoder = content_hash(encoder_folder(task.speech_encoder))
        options = config.to_dict()
        options["task"].pop("operator_memory_gb", None)  # changes no weights
        described = [self.kind, options, data, encoder]
        content = json.dumps(described, sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class Trained:
    """A finished training.

    Attributes:
        directory: folder with its weights.
        key: of the training.
        record: what results say of it.
    """

    directory: Path
    key: str
    record: dict[str, Any]


class StoppedError(RuntimeError):
    """A training was told to stop before its end; it goes on from there."""


def train(training: Training, catalogue: Catalogue, work: Path) -> Trained:
    """Weights of a training: from the work folder where it was finished, else trained (on).

    Raises:
        StoppedError: it was interrupted.
    """
    key = training.key(catalogue)
    out = work / "trainings" / f"{training.kind}-{key}"
    done = out / "done.json"
    if done.is_file():
        return Trained(out / training.kind, key, json.loads(done.read_text()))
    overrides = [f"task.feature_cache={work / 'features'}"] if training.kind != "stm" else []
    config = load_config(training.kind, training.config, [*training.overrides, *overrides])
    corpus = catalogue.mixture(training.sets, training.view)
    began = time.perf_counter()
    result = train_dataset(config, lambda: corpus, out, f"table row {training.kind}")
    if result.status != "finished":
        raise StoppedError(f"{out} stopped after step {result.step}")
    record = {
        "kind": training.kind,
        "key": key,
        "sets": list(training.sets),
        "view": asdict(training.view),
        "config": training.config,
        "overrides": list(training.overrides),
        "seed": config.loop.seed,
        "steps": result.step,
        "minutes": round((time.perf_counter() - began) / 60, 2),
        "parameters": result.parameters,
        "validation": result.scores,
        "data": corpus.describe(),
        "data_fingerprint": corpus.fingerprint,
        "commit": git_commit(),
    }
    write_json(done, record)
    return Trained(result.directory, key, record)
