#!/usr/bin/env python3
"""Whether the papers' networks learn: their loss on one batch, step by step, with their options and precision.

    scripts/bench/fixed_batch.py ats --data corpus task.speech_encoder=open-small
    scripts/bench/fixed_batch.py stm --data corpus task.num_meshes=1

The batch, its noise and its diffusion steps stay the same, so the loss has to fall; exits with 1 where it does not fall
to half. Of several datasets (--data again) each gives its share of the batch.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from itertools import zip_longest
from pathlib import Path

import numpy as np
import torch
from accelerate.utils import send_to_device

from freetalk.data import open_datasets
from freetalk.train import load_config
from freetalk.train.engine import choose_device
from freetalk.train.run import make_task
from freetalk.train.sequences import Epochs
from freetalk.train.weights import parameter_groups


def turn_by_turn(epochs: Epochs, count: int) -> list[tuple[str, int]]:
    """Dataset and number of the first items, the datasets taking turns."""
    of: dict[str, list[tuple[str, int]]] = {}
    for number in range(len(epochs)):
        name = epochs.window(number)[0].dataset
        of.setdefault(name, []).append((name, number))
    return [item for turn in zip_longest(*of.values()) for item in turn if item][:count]


def main() -> int:
    """Reads the command line and trains; 0 where the loss fell to half."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("ats", "stm"))
    parser.add_argument("--data", action="append", required=True)
    parser.add_argument("--config", help="name of a configuration; KIND_paper by default")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--batch", type=int, default=2)
    parser.add_argument("--threads", type=int, default=0, help="CPU threads; 0: torch's choice")
    parser.add_argument("overrides", nargs="*", metavar="section.key=value")
    given = parser.parse_intermixed_args()
    if given.threads:
        torch.set_num_threads(given.threads)
    config = load_config(given.kind, given.config or f"{given.kind}_paper", given.overrides)
    device = choose_device(config.loop)
    with tempfile.TemporaryDirectory() as out:
        task = make_task(config, open_datasets(given.data), Path(out), device)
        numbers = turn_by_turn(task.epochs, given.batch)
        items = [task.item(np.random.default_rng(number), number) for _, number in numbers]
        batch = send_to_device(task.collate(items), device)
    size = sum(parameter.numel() for parameter in task.model.parameters())
    print(f"{given.kind}: {size / 1e6:.1f} M weights, items of {[name for name, _ in numbers]}")
    groups = parameter_groups(task.model, config.loop.weight_decay)
    optimizer = torch.optim.AdamW(groups, lr=config.loop.learning_rate)
    task.model.train()
    losses: list[float] = []
    began = time.perf_counter()
    for step in range(given.steps):
        optimizer.zero_grad(set_to_none=True)
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=config.loop.bf16):
            loss = task.loss(batch, torch.Generator())["loss"]
        loss.backward()
        torch.nn.utils.clip_grad_norm_(task.model.parameters(), config.loop.grad_clip)
        optimizer.step()
        losses.append(float(loss.detach()))
        if step % 20 == 0 or step == given.steps - 1:
            print(f"step {step}: {losses[-1]:.5g}, {time.perf_counter() - began:.0f} s", flush=True)
    first, last = losses[0], float(np.mean(losses[-5:]))
    print(f"{given.kind}, bf16 {config.loop.bf16}: the loss fell from {first:.5g} to {last:.5g}")
    return int(not last < 0.5 * first)


if __name__ == "__main__":
    sys.exit(main())
