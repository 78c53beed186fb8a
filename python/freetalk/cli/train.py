"""``freetalk train``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from freetalk.cli.app import EXIT_STOPPED
from freetalk.cli.outputs import check_readable, check_writable


def run(arguments: argparse.Namespace) -> None:
    """Trains a model; continues when the output folder holds an unfinished run.

    Raises:
        SystemExit: it was told to stop; the shell's 130, so that ``train && evaluate`` stops too.
    """
    if Path(arguments.config).suffix:  # otherwise the name of a shipped one
        check_readable(arguments.config, "a configuration (YAML)")
    for spec in arguments.data:
        path = spec if Path(spec).exists() else spec.rpartition("=")[2]
        if not Path(path).is_dir():
            raise OSError(f"'{path}' is no folder: give a corpus ('freetalk corpus build')")
    for override in arguments.overrides:
        if "=" not in override:
            raise ValueError(f"'{override}' is not understood: write section.key=value")
    check_writable(Path(arguments.out), is_folder=True)
    from freetalk import train

    result = train.run(
        arguments.kind, arguments.config, arguments.overrides, arguments.data, arguments.out
    )
    if int(os.environ.get("RANK", "0")) == 0:  # of several processes one speaks
        scores = ", ".join(f"{name} {value:.4g}" for name, value in result.scores.items())
        print(f"{result.status} at step {result.step}: {scores or 'no validation yet'}")
        print(f"weights in {result.directory}")
        ready = f"`freetalk animate --pretrained {arguments.out}` takes this folder"
        print(result.lacking or ready)
    if result.status == "interrupted":
        raise SystemExit(EXIT_STOPPED)
