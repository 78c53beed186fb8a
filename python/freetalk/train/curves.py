"""Where the curves of a training go: TensorBoard, a CSV file, Weights & Biases, through accelerate's trackers."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

LOGGERS = ("tensorboard", "csv", "wandb")


class Curves:
    """Open loggers.

    Args:
        loggers: of ``LOGGERS``.
        out: output folder of the training: ``tensorboard/<kind>/``, ``curves/<kind>.csv``, ``wandb/``.
        config: of the training.
        step: finished steps; points after it, of an earlier run, are dropped.

    Raises:
        RuntimeError: a logger's package is missing.
    """

    def __init__(self, loggers: list[str], out: Path, config: dict[str, Any], step: int) -> None:
        from accelerate.tracking import TensorBoardTracker, WandBTracker, get_available_trackers

        installed = {str(found) for found in get_available_trackers()} | {"csv"}
        for missing in [name for name in loggers if name not in installed]:
            raise RuntimeError(
                f"loop.loggers: {missing} is not installed here: pip install {missing}"
            )
        kind = config["kind"]
        self._csv = _Csv(out / "curves" / f"{kind}.csv", step) if "csv" in loggers else None
        self._trackers: list[Any] = []
        if "tensorboard" in loggers:
            self._trackers.append(TensorBoardTracker(kind, out / "tensorboard", purge_step=step))
        if "wandb" in loggers:
            self._trackers.append(
                WandBTracker(f"freetalk-{kind}", dir=str(out), config=config, resume="allow")
            )
        for tracker in self._trackers:
            tracker.start()
            if tracker.name == "tensorboard":
                text = json.dumps(config, indent=2).replace("\n", "\n    ")
                tracker.log({"config": f"    {text}"}, step=step)

    def log(self, values: dict[str, float], step: int) -> None:
        """A point of each curve."""
        for tracker in self._trackers:
            tracker.log(values, step=step)
        if self._csv is not None:
            self._csv.log(values, step)

    def picture(self, picture: npt.NDArray[np.uint8], step: int) -> None:
        """A picture (H, W, 3), where a logger shows pictures."""
        for tracker in self._trackers:
            if tracker.name == "tensorboard":
                tracker.log_images({"sample": picture[None]}, step=step, dataformats="NHWC")
            else:
                tracker.log_images({"sample": [picture]}, step=step)

    def close(self) -> None:
        """Ends all of them."""
        for tracker in self._trackers:
            tracker.finish()
        if self._csv is not None:
            self._csv.file.close()


class _Csv:
    """Rows of step, curve and value."""

    def __init__(self, path: Path, step: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        rows: list[list[str]] = []
        if path.is_file():
            with path.open(newline="", encoding="utf-8") as file:
                rows = [row for row in list(csv.reader(file))[1:] if int(row[0]) <= step]
        self.file = path.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self.file)
        self._writer.writerows([["step", "curve", "value"], *rows])
        self.file.flush()

    def log(self, values: dict[str, float], step: int) -> None:
        self._writer.writerows([step, name, repr(value)] for name, value in values.items())
        self.file.flush()
