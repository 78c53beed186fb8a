#!/usr/bin/env python3
"""Times STM's decoding of frames against the public DiffusionNet's layers, both in turns within one run.

The other side is the network written out in plain PyTorch (tests/python/plain_nets.py): mesh features computed
once, landmarks attended to, [f, g, c] concatenated, frames batched by eight, gradients as sparse products; for
bfloat16 under autocast, those products in float32. Medians are printed, of the time that passes and of the
processors' time, which other programs on the machine disturb less. Weights are the paper's size and drawn at
random, last layer and diffusion times included, or the shipped ones. Run on an idle machine:

    python scripts/bench/stm.py                      # speed at 5,023 vertices, float32 and bfloat16
    python scripts/bench/stm.py --weights shipped    # the same with the shipped weights
    python scripts/bench/stm.py --part memory        # 50,000 vertices, 30 and 300 frames: peak memory
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial import Delaunay
from torch.nn import functional

import freetalk
from freetalk.geometry import surface_operators
from freetalk.stm import Stm, StmOptions
from freetalk.train.config import load_config

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "python"))

from plain_nets import PlainDiffusionNet, plain_mesh  # noqa: E402

BATCH = 8  # frames that the plain network takes at once


def face_sheet(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A bent, wavy sheet the size of a face with ``count`` irregular vertices, metres."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-1.2, 1.2, (2, count))
    depth = 0.09 * np.cos(u) * np.cos(v) + 0.004 * np.sin(9 * u) * np.cos(7 * v)
    vertices = np.stack([0.08 * np.sin(u), 0.11 * np.sin(v), depth], 1)
    return vertices, Delaunay(np.stack([u, v], 1)).simplices.astype(np.int32)


def make_model(weights: str) -> Stm:
    """The shipped model, or one of the paper's size that moves."""
    if weights == "shipped":
        return Stm.from_pretrained(
            Path(freetalk.__file__).parent / "pretrained" / "open-small" / "stm"
        )
    torch.manual_seed(0)
    model = Stm(StmOptions.from_dict(load_config("stm", "stm_paper").model))
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if name == "decoder.last_lin.weight":
                parameter.normal_(0, 0.3)
            elif name.endswith("diffusion_time"):
                parameter.uniform_(0.001, 0.02)
    return model.eval()


class Float32Product:
    """A sparse matrix that stays float32 under autocast: PyTorch multiplies none in bfloat16 on a CPU."""

    def __init__(self, matrix: torch.Tensor) -> None:
        self.matrix = matrix

    def __matmul__(self, x: torch.Tensor) -> torch.Tensor:
        with torch.autocast("cpu", enabled=False):
            return self.matrix @ x.float()


class PlainDecoder:
    """Eq. 13-14 and the decoder as public layers, frames in batches."""

    def __init__(self, model: Stm, positions: torch.Tensor, operators: Any) -> None:
        o = model.options
        self.options = o
        self.mesh: dict[str, Any] = plain_mesh(operators, torch.float32)
        for name in ("grad_x", "grad_y"):
            self.mesh[name] = Float32Product(self.mesh[name])
        self.state = {name: value.detach() for name, value in model.state_dict().items()}
        self.model = model
        channels = o.feature_dim + 204 + o.attention_dim
        self.decoder = self._net("decoder.", channels, 3, o.decoder_width, o.decoder_blocks)
        encoder = self._net("encoder.", 6, o.feature_dim, o.encoder_width, o.encoder_blocks)
        inputs = torch.cat([positions / o.length_scale, operators.normals], 1)
        self.features = encoder(inputs, self.mesh)
        self.queries = self._heads(self._linear("query_proj", self.features)[None])

    def _net(self, prefix: str, *sizes: int) -> PlainDiffusionNet:
        net = PlainDiffusionNet(*sizes)
        net.load_state_dict(
            {k[len(prefix) :]: v for k, v in self.state.items() if k.startswith(prefix)}
        )
        return net.eval()

    def _linear(self, name: str, x: torch.Tensor) -> torch.Tensor:
        return functional.linear(x, self.state[f"{name}.weight"], self.state[f"{name}.bias"])

    def _heads(self, x: torch.Tensor) -> torch.Tensor:
        return x.unflatten(-1, (self.options.attention_heads, -1)).transpose(1, 2)

    def _landmark_features(self, motion: torch.Tensor) -> torch.Tensor:
        local = motion
        for layer in range(self.options.gcn_layers):
            local = self.state["gcn.adjacency"] @ self._linear(f"gcn.layer_{layer}", local)
            local = torch.relu(local) if layer + 1 < self.options.gcn_layers else local
        codes = self.state["index_code"].expand(len(motion), -1, -1)
        return self._linear("landmark_proj", torch.cat([local, codes], -1))

    def decode(self, landmarks: torch.Tensor) -> torch.Tensor:
        parts = []
        for motion in (landmarks / self.options.displacement_scale).split(BATCH):
            joined = self._landmark_features(motion)
            attended = functional.scaled_dot_product_attention(
                self.queries.expand(len(motion), -1, -1, -1),
                self._heads(self._linear("key_proj", joined)),
                self._heads(self._linear("value_proj", joined)),
            )
            count = len(self.features)
            fused = torch.cat(
                [
                    self.features.expand(len(motion), -1, -1),
                    motion.flatten(1)[:, None].expand(-1, count, -1),
                    attended.transpose(1, 2).flatten(2),
                ],
                -1,
            )
            parts.append(self.decoder(fused, self.mesh) * self.options.displacement_scale)
        return torch.cat(parts)


def in_turns(sides: dict[str, Callable[[], Any]], rounds: int) -> dict[str, tuple[float, float]]:
    """Median seconds that pass and of all processors, of sides timed in turns ``rounds`` times, warm."""
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in sides}
    for turn in range(rounds + 1):
        for name, run in sides.items():
            start = time.perf_counter(), time.process_time()
            run()
            if turn > 0:
                seconds[name].append(
                    (time.perf_counter() - start[0], time.process_time() - start[1])
                )
    return {
        name: (statistics.median(s[0] for s in values), statistics.median(s[1] for s in values))
        for name, values in seconds.items()
    }


def prepare(model: Stm, count: int) -> tuple[torch.Tensor, Any]:
    vertices, triangles = face_sheet(count)
    o = model.options
    operators = surface_operators(vertices / o.length_scale, triangles, k=o.k_eig)
    return torch.from_numpy(vertices).float(), operators.to(dtype=torch.float32)


def motion_of(frames: int) -> torch.Tensor:
    """Landmarks that move by a few millimetres, smoothly."""
    generator = torch.Generator().manual_seed(0)
    steps = torch.randn(frames + 8, 68, 3, generator=generator)
    return 0.003 * steps.unfold(0, 9, 1).mean(-1) * 3


def speed(arguments: argparse.Namespace) -> None:
    """Frames a second of each side and the error of each precision."""
    model = make_model(arguments.weights)
    positions, operators = prepare(model, arguments.vertices)
    landmarks = motion_of(arguments.frames)
    plain = PlainDecoder(model, positions, operators)
    mesh = model.encode(positions, operators)
    fast = {
        precision: model.frame_decoder(mesh, operators, precision=precision)
        for precision in ("float32", "bfloat16")
    }

    @torch.autocast("cpu", torch.bfloat16)
    def rounded() -> torch.Tensor:
        return plain.decode(landmarks).float()

    sides: dict[str, Callable[[], Any]] = {
        "plain": lambda: plain.decode(landmarks),
        "plain bf16": rounded,
    }
    for name, decoder in fast.items():
        sides[name] = lambda decoder=decoder: decoder.decode(landmarks)  # type: ignore[misc]
    medians = in_turns(sides, arguments.rounds)
    exact = plain.decode(landmarks)
    print(f"{arguments.vertices} vertices, {arguments.weights} weights, {arguments.frames} frames, "
          f"{torch.get_num_threads()} threads")  # fmt: skip
    for name, (seconds, processors) in medians.items():
        line = f"{name:10} {arguments.frames / seconds:6.1f} frames/s"
        line += f"  {1000 * processors / arguments.frames:6.1f} ms of processors a frame"
        if name in fast:
            error = (fast[name].decode(landmarks) - exact).norm(dim=-1).mean()
            relative = float(error / exact.norm(dim=-1).mean())
            peer = "plain" if name == "float32" else "plain bf16"
            plain_seconds, plain_processors = medians[peer]
            line += f"  {plain_seconds / seconds:5.2f} x, {plain_processors / processors:5.2f} x of {peer}"
            line += f"  error {100 * relative:.4f} % of motion"
        print(line)


def memory(arguments: argparse.Namespace) -> None:
    """Peak memory of the process before and after decodings of different lengths."""
    model = make_model(arguments.weights)
    positions, operators = prepare(model, 50_000)
    mesh = model.encode(positions, operators)
    decoder = model.frame_decoder(mesh, operators, precision=arguments.precision)

    def peak() -> float:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2

    print(f"50000 vertices, {arguments.precision}: operators and features {peak():.2f} GiB")
    for frames in (30, 300):
        start = time.perf_counter()
        result = decoder.decode(motion_of(frames))
        seconds, size = time.perf_counter() - start, result.nbytes / 1024**3
        print(f"{frames:4} frames: peak {peak():.2f} GiB, {size:.2f} of it the result; "
              f"{frames / seconds:.1f} frames/s")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", choices=("speed", "memory"), default="speed")
    parser.add_argument("--weights", choices=("paper", "shipped"), default="paper")
    parser.add_argument("--vertices", type=int, default=5023)
    parser.add_argument("--frames", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    with torch.no_grad():
        (speed if arguments.part == "speed" else memory)(arguments)


if __name__ == "__main__":
    main()
