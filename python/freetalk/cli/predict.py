"""``freetalk predict``."""

from __future__ import annotations

import argparse
from pathlib import Path

from freetalk.cli.evaluate import find_stages
from freetalk.cli.motion_options import diffusion_options
from freetalk.cli.outputs import check_writable


def run(arguments: argparse.Namespace) -> None:
    """Writes the motion that weights predict for a split of a dataset."""
    needed = ["speech", "ats"] if arguments.driver == "speech" else []
    if arguments.topology != "landmarks":
        needed.append("stm")
    weights = find_stages(arguments.pretrained, needed)
    out = Path(arguments.out)
    check_writable(out, is_folder=True)
    from freetalk.data import open_datasets
    from freetalk.evaluate.predict import PredictOptions, predict

    count = predict(
        open_datasets(arguments.data),
        weights,
        out,
        PredictOptions(
            split=arguments.split,
            topology=arguments.topology,
            driver=arguments.driver,
            samples=arguments.samples,
            seed=arguments.seed,
            sampling=diffusion_options(arguments),
        ),
        device=arguments.device,
        batch=getattr(arguments, "batch", 0),
    )
    print(
        f"{count} files in {out}; score them: freetalk evaluate --pred {out} --gt {arguments.data}"
    )
