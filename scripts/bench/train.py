#!/usr/bin/env python3
"""Training speed: samples a second of freetalk's trainer against the same model in plain PyTorch.

The peers run the same weights, batches, loss, precision, clipping and AdamW in a hand-written loop: eager, and
through ``torch.compile`` where that works. Contestants take turns; figures are medians over the rounds.

    scripts/bench/train.py ats                                 # 4 windows of 150 frames, small enough for a CPU
    scripts/bench/train.py stm
    scripts/bench/train.py ats --config ats_paper --frames 600 --batch 16 --contestants freetalk --rounds 1

Memory is the peak of the process: give one contestant to measure it alone. On a busy machine the CPU seconds
are the fairer figure.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from accelerate.utils import send_to_device
from torch import Tensor
from train_reference import PlainAts, PlainStm

from freetalk.ats import Ats, AtsOptions
from freetalk.corpus.assets import mean_face
from freetalk.diffusion import Schedule
from freetalk.geometry import surface_operators
from freetalk.stm import Stm, StmOptions
from freetalk.train.config import TrainingConfig, load_config
from freetalk.train.engine import Engine
from freetalk.train.loop import Trainer
from freetalk.train.losses import motion_loss

Step = Callable[[], float]


class AtsBench:
    """Windows of noise through the denoiser; ``network`` is freetalk's model or its peer."""

    epochs = None

    def __init__(self, config: TrainingConfig, frames: int, network: str) -> None:
        options = AtsOptions.from_dict({"audio_dim": 768, **config.model})
        self.frames, self.options = frames, options
        ours = Ats(options)
        self.model: Any = ours if network == "freetalk" else PlainAts(options)
        self.plain = network != "freetalk"
        self.schedule = Schedule()

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """A window."""
        return {
            "audio": rng.standard_normal((self.frames, self.options.audio_dim), dtype=np.float32),
            "motion": rng.standard_normal((self.frames, 204), dtype=np.float32),
            "noise": rng.standard_normal((self.frames, 204), dtype=np.float32),
            "step": int(rng.integers(1000)),
        }

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Full windows, so that no contestant skips padding."""
        count = len(items)
        batch = {
            k: torch.from_numpy(np.stack([i[k] for i in items])) for k in items[0] if k != "step"
        }
        batch["step"] = torch.tensor([i["step"] for i in items])
        batch["valid"] = torch.ones(count, self.frames, dtype=torch.bool)
        batch["emotion"] = torch.eye(len(self.options.emotions))[:1].expand(count, -1)
        batch["intensity"] = torch.ones(count)
        batch["drop_audio"] = batch["drop_affect"] = torch.zeros(count, dtype=torch.bool)
        return batch

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 of the paper."""
        noisy = self.schedule.q_sample(batch["motion"], batch["step"], noise=batch["noise"])
        if self.plain:
            guess = self.model(noisy, batch["step"], batch)
        else:
            names = ("audio", "emotion", "intensity", "valid", "drop_audio", "drop_affect")
            guess = self.model(noisy, batch["step"], **{name: batch[name] for name in names})
        shape = (len(noisy), self.frames, 68, 3)
        target = batch["motion"].view(shape)
        return motion_loss(guess.float().view(shape), target, batch["valid"], 0.3, 0.1)


class StmBench:
    """Motion of the mean face; an item is a window."""

    epochs = None

    def __init__(self, config: TrainingConfig, frames: int, network: str) -> None:
        options = StmOptions.from_dict(config.model)
        self.frames = frames
        self.model: Any = Stm(options) if network == "freetalk" else PlainStm(options)
        vertices, faces = mean_face("face")
        self.vertices = torch.from_numpy(vertices)
        self.operators = surface_operators(
            vertices.astype(np.float64) / options.length_scale, faces, k=options.k_eig
        ).to(dtype=torch.float32)

    def item(self, rng: np.random.Generator, number: int) -> dict[str, Any]:
        """Landmark and vertex displacements, m."""
        landmarks = rng.standard_normal((self.frames, 68, 3), dtype=np.float32) * 2e-3
        target = rng.standard_normal((self.frames, *self.vertices.shape), dtype=np.float32) * 2e-3
        return {"landmarks": torch.from_numpy(landmarks), "target": torch.from_numpy(target)}

    def collate(self, items: list[dict[str, Any]]) -> dict[str, Any]:
        """Windows side by side."""
        return {"items": items}

    def loss(self, batch: dict[str, Any], generator: torch.Generator) -> dict[str, Tensor]:
        """Eq. 15 of the paper, averaged over the windows."""
        device = batch["items"][0]["target"].device
        if self.vertices.device != device:
            self.vertices = self.vertices.to(device)
            self.operators = self.operators.to(torch.float32, str(device))
        total = torch.zeros((), device=device)
        for item in batch["items"]:
            guess = self.model(self.vertices, self.operators, item["landmarks"]).float()
            total = total + 1e6 * motion_loss(guess, item["target"], None, 0.5, 0.2)["loss"]
        return {"loss": total / len(batch["items"])}


def our_step(task: Any, config: TrainingConfig, out: Path) -> Step:
    """A step of freetalk's trainer."""
    engine = Engine(config.loop)
    task.model.to(engine.device)
    trainer = Trainer(task, config, out, "noise", engine=engine)
    draws = trainer.draws()
    task.model.train()
    return lambda: trainer.advance(draws)["loss"]


def plain_step(task: Any, config: TrainingConfig, compiled: bool) -> Step:
    """A step of the usual hand-written loop, over one batch that is drawn beforehand."""
    loop = config.loop
    device = torch.device("cuda" if torch.cuda.is_available() and loop.device != "cpu" else "cpu")
    model = task.model.to(device).train()
    optimizer = torch.optim.AdamW(
        model.parameters(), lr=loop.learning_rate, weight_decay=loop.weight_decay
    )
    items = [task.item(np.random.default_rng([loop.seed, 0, i]), i) for i in range(loop.batch_size)]
    batch = send_to_device(task.collate(items), device)
    if compiled:
        task.model = torch.compile(model)

    def step() -> float:
        optimizer.zero_grad(set_to_none=True)
        with torch.autocast(device.type, dtype=torch.bfloat16, enabled=loop.bf16):
            loss = task.loss(batch, torch.Generator())["loss"]
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), loop.grad_clip)
        optimizer.step()
        return float(loss.detach())

    return step


def make_steps(arguments: argparse.Namespace, config: TrainingConfig, out: Path) -> dict[str, Step]:
    """One step function for each contestant, all with the same weights."""
    bench = AtsBench if arguments.kind == "ats" else StmBench
    state = None
    steps: dict[str, Step] = {}
    for name in arguments.contestants:
        torch.manual_seed(0)
        task = bench(config, arguments.frames, name)
        if state is None:
            source = task if name == "freetalk" else bench(config, arguments.frames, "freetalk")
            # Some weights start at 0, where a wrong peer would go unnoticed.
            state = {
                key: value.detach() if value.any() else 0.02 * torch.randn_like(value).abs()
                for key, value in source.model.named_parameters()
            }
        task.model.load_state_dict({**task.model.state_dict(), **state})
        if name == "freetalk":
            steps[name] = our_step(task, config, out)
        else:
            steps[name] = plain_step(task, config, compiled=name == "compiled")
    return steps


def measure(arguments: argparse.Namespace, steps: dict[str, Step], batch: int) -> None:
    """Prints samples a second and ratios."""
    for name in list(steps):
        try:
            began = time.perf_counter()
            loss = steps[name]()
            print(
                f"{name}: first step {time.perf_counter() - began:.1f} s, loss {loss:.6g}",
                flush=True,
            )
        except Exception as error:
            print(f"{name}: does not run ({type(error).__name__}: {str(error).splitlines()[0]})")
            del steps[name]
    seconds: dict[str, list[float]] = {name: [] for name in steps}
    busy: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(arguments.rounds):
        for name, step in steps.items():
            began, worked = time.perf_counter(), time.process_time()
            for _ in range(arguments.steps):
                step()  # reads the loss, so a GPU has finished
            seconds[name].append((time.perf_counter() - began) / arguments.steps)
            busy[name].append((time.process_time() - worked) / arguments.steps)
    for name, values in seconds.items():
        middle = statistics.median(values)
        ratio = ""
        if name != "freetalk" and "freetalk" in seconds:
            pairs = [theirs / ours for theirs, ours in zip(values, seconds["freetalk"])]
            ratio = f"; freetalk is {statistics.median(pairs):.2f} x as fast"
            pairs = [theirs / ours for theirs, ours in zip(busy[name], busy["freetalk"])]
            ratio += f" ({statistics.median(pairs):.2f} x in CPU seconds)"
        work = f"{statistics.median(busy[name]):.3g} CPU seconds a step"
        print(f"{name}: {batch / middle:.3g} samples/s, {1 / middle:.3g} steps/s, {work}{ratio}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"peak memory of the process: {peak:.2f} GiB")
    if torch.cuda.is_available():
        print(f"peak memory of the GPU: {torch.cuda.max_memory_allocated() / 2**30:.2f} GiB")


def main() -> None:
    """Reads the command line and measures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("ats", "stm"))
    parser.add_argument("--config", help="name of a configuration; KIND_paper by default")
    parser.add_argument("--batch", type=int, help="samples of a step: 4 (ats), 1 (stm)")
    parser.add_argument("--frames", type=int, help="frames of a sample: 150 (ats), 8 (stm)")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=1, help="steps of each in a round")
    parser.add_argument("--threads", type=int, default=0, help="CPU threads; 0: torch's choice")
    known = ("freetalk", "eager", "compiled")
    parser.add_argument("--contestants", nargs="+", choices=known, default=list(known))
    parser.add_argument("--set", nargs="+", default=[], metavar="section.key=value")
    arguments = parser.parse_args()
    batch = arguments.batch or {"ats": 4, "stm": 1}[arguments.kind]
    arguments.frames = arguments.frames or {"ats": 150, "stm": 8}[arguments.kind]
    if arguments.threads:
        torch.set_num_threads(arguments.threads)
    overrides = [f"loop.batch_size={batch}", "loop.epochs=0", *arguments.set]
    config = load_config(arguments.kind, arguments.config or f"{arguments.kind}_paper", overrides)
    print(
        f"{arguments.kind}: batch {batch}, {arguments.frames} frames, bf16 {config.loop.bf16}, "
        f"{torch.get_num_threads()} threads, torch {torch.__version__}"
    )
    with tempfile.TemporaryDirectory() as out:
        measure(arguments, make_steps(arguments, config, Path(out)), batch)


if __name__ == "__main__":
    main()
