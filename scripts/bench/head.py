"""Times a parametric head's surface, tracking and fitting against dense eager PyTorch, in turns within one run.

    pip install scikit-image
    python scripts/bench/head.py
    python scripts/bench/head.py --head PRETRAINED/head --size small --repeats 3
    python scripts/bench/head.py --size paper --repeats 1

The peers evaluate every local network at every point, as the public NPHM code does: a mesh asks all 256^3 points
(timed on slices of 25,000 and multiplied) and takes scikit-image's marching cubes; tracking is the forward network in
eager torch; fitting a frame is FaceTalk's Adam, 500 steps over 5,000 points (timed on --adam-steps of them). Without
--head, a head of the size asked is first fitted to an ellipsoid, a minute.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
from skimage.measure import marching_cubes
from torch import Tensor

from freetalk import head as heads

SLICE = 25_000  # points that the public code asks at once


def ellipsoid_head(options: heads.HeadOptions, steps: int) -> heads.ParametricHead:
    """A head whose canonical surface is an ellipsoid of a head's size, moved a little by its codes."""
    torch.manual_seed(0)
    model = heads.ParametricHead(options)
    axes = torch.tensor([0.36, 0.5, 0.42])
    with torch.no_grad():
        directions = torch.nn.functional.normalize(torch.randn(options.num_anchors, 3), dim=1)
        directions[:, 2] = directions[:, 2].abs()
        model.state_dict()["identity.anchors"].copy_(axes * directions)
        model.state_dict()["identity.mlp_pos.4.weight"].mul_(0.1)
        for name, parameter in model.named_parameters():
            if name.startswith("deformation_"):
                parameter.mul_(0.7)
    adam = torch.optim.Adam(
        [p for name, p in model.named_parameters() if name.startswith("identity.ensembled")], 2e-3
    )
    z_id = torch.zeros(1, model.identity_dim)
    for _ in range(steps):
        points = 1.4 * (torch.rand(1, 2000, 3) - 0.5)
        length = (points / axes).norm(dim=2)
        wanted = (1 - 1 / length.clamp_min(0.05)) * points.norm(dim=2)
        loss = (model.canonical_sdf(points, z_id) - wanted).abs().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    return model.eval()


def dense_sdf(model: heads.ParametricHead) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    """The head in eager torch operations, every local network everywhere."""
    options, state = model.options, model.state_dict()
    pairs, members = options.num_pairs, options.num_anchors + 1

    def mlp(prefix: str, layers: int, inputs: Tensor, shared: bool) -> Tensor:
        x = inputs
        for index in range(layers + 1):
            weight = state[f"{prefix}lin{index}.weight"]
            bias = state[f"{prefix}lin{index}.bias"]
            if index == layers // 2:
                x = torch.cat([x, inputs], -1) / 2**0.5
            if shared:
                weight, bias = (
                    torch.cat([t[:pairs].repeat_interleave(2, 0), t[pairs:]])
                    for t in (weight, bias)
                )
                x = torch.baddbmm(bias[:, None], x, weight.transpose(1, 2))
            else:
                x = torch.nn.functional.linear(x, weight, bias)
            if index < layers:
                x = torch.nn.functional.softplus(x, beta=100)
        return x

    def move(way: str, points: Tensor, z_id: Tensor, anchors: Tensor, z_exp: Tensor) -> Tensor:
        code = torch.nn.functional.linear(
            torch.cat([z_id, anchors.flatten(1)], 1),
            state[f"{way}.compressor.0.weight"],
            state[f"{way}.compressor.0.bias"],
        )
        code = torch.cat([code, z_exp], 1).expand(len(points), -1)
        inputs = torch.cat([points, code], 1)
        return points + mlp(f"{way}.defDeepSDF.", options.deformation_layers, inputs, False)[:, :3]

    def sdf(points: Tensor, z_id: Tensor, z_exp: Tensor) -> Tensor:
        anchors = model.anchors(z_id)
        x = move("deformation_backward", points, z_id, anchors, z_exp)
        origins = torch.cat([anchors[0], torch.zeros(1, 3)])
        local = x[None] - origins[:, None]
        flip = torch.ones(members, 1, 3)
        flip[1 : 2 * pairs : 2, :, 0] = -1
        codes = torch.cat(
            [
                z_id[:, : options.global_dim].expand(members, -1),
                z_id[0, options.global_dim :].view(members, -1),
            ],
            1,
        )
        inputs = torch.cat([local * flip, codes[:, None].expand(-1, len(points), -1)], 2)
        values = mlp("identity.ensembled_deep_sdf.", options.identity_layers, inputs, True).squeeze(
            2
        )
        exponents = -((local[:-1].norm(dim=2) + 1e-5) ** 2) / options.kernel_width**2
        weights = torch.cat([exponents, torch.full((1, len(points)), -20.0)]).exp()
        return (weights * values).sum(0) / (weights.sum(0) + options.normalizer_eps)

    sdf.move = move  # type: ignore[attr-defined]
    return sdf


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def report(name: str, peer: list[float], ours: list[float], rows: str = "") -> None:
    a, b = statistics.median(peer), statistics.median(ours)
    print(f"{name:34s} peer {a:10.3f} s   ours {b:8.4f} s   {a / b:8.1f} x   {rows}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--head", help="folder of a head (default: an ellipsoid's)")
    parser.add_argument("--size", choices=("small", "paper"), default="small")
    parser.add_argument("--steps", type=int, default=200, help="of fitting the ellipsoid")
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--vertices", type=int, default=12_000, help="tracked")
    parser.add_argument("--adam-steps", type=int, default=3, help="timed of 500")
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    if arguments.head:
        model = heads.ParametricHead.from_pretrained(arguments.head).eval()
    else:
        options = heads.nphm_small_options()
        if arguments.size == "paper":
            options = heads.HeadOptions(direction="both", normalizer_eps=1e-14)
        model = ellipsoid_head(options, arguments.steps)
    rest = model.state_dict()["rest_expression"]
    z_id = torch.zeros(model.identity_dim)
    if arguments.head:
        z_id = model.sample_identity(1, seed=0)[0].detach()
    prepared = heads.PreparedHead(model, z_id)
    surface = heads.SurfaceOptions(resolution=arguments.resolution)
    measure(model, prepared, surface, z_id, rest, arguments)


@torch.no_grad()
def measure(
    model: heads.ParametricHead,
    prepared: heads.PreparedHead,
    surface: heads.SurfaceOptions,
    z_id: Tensor,
    rest: Tensor,
    arguments: argparse.Namespace,
) -> None:
    dense = dense_sdf(model)
    low, high = (torch.tensor(side) for side in (model.options.box_min, model.options.box_max))
    some = low + (high - low) * torch.rand(SLICE, 3)
    points = arguments.resolution**3
    axes = np.linspace(-1, 1, arguments.resolution, dtype=np.float32)
    ball = np.sqrt(axes[:, None, None] ** 2 + axes[:, None] ** 2 + axes**2) - 0.7
    codes = rest + 0.05 * torch.randn(8, len(rest)).cumsum(0)
    sequence = heads.SurfaceExtractor(prepared, surface)
    sequence.next(codes[0])
    template = torch.rand(arguments.vertices, 3) * 0.1
    anchors = model.anchors(z_id[None])
    times: dict[str, tuple[list[float], list[float]]] = {}

    def turn(name: str, peer: float, ours: float) -> None:
        times.setdefault(name, ([], []))
        times[name][0].append(peer)
        times[name][1].append(ours)

    for index in range(arguments.repeats):
        of_slice = seconds(lambda: dense(some, z_id[None], rest[None]))
        of_mesh = seconds(lambda: marching_cubes(ball, 0.0))
        whole = of_slice * points / SLICE + of_mesh
        alone = seconds(lambda: heads.extract(prepared, rest, options=surface))
        next_code = codes[1 + index % 7]
        turn("mesh alone", whole, alone)
        turn("mesh in a sequence", whole, seconds(lambda code=next_code: sequence.next(code)))
        turn(
            f"track {arguments.vertices} vertices, a frame",
            seconds(
                lambda: dense.move(
                    "deformation_forward", 4 * template, z_id[None], anchors, rest[None]
                )
            ),  # type: ignore[attr-defined]
            seconds(lambda: heads.track(prepared, template, rest[None])),
        )
    for name, (peer, ours) in times.items():
        report(name, peer, ours)
    mesh = heads.extract(prepared, rest, options=surface)
    print(f"  {len(mesh.vertices)} vertices, field asked at {mesh.num_evaluations} points")
    fitting(model, dense, mesh, z_id, rest, arguments)


def fitting(
    model: heads.ParametricHead,
    dense: Callable[[Tensor, Tensor, Tensor], Tensor],
    mesh: heads.Surface,
    z_id: Tensor,
    rest: Tensor,
    arguments: argparse.Namespace,
) -> None:
    rng = np.random.default_rng(0)
    points = torch.tensor(mesh.vertices[rng.integers(len(mesh.vertices), size=5000)]).float()
    scaled = points * model.options.units_per_metre
    start = rest + 0.1 * torch.randn(1, len(rest))
    code = start.clone().requires_grad_()
    adam = torch.optim.Adam([code], 1e-3)

    def steps() -> None:
        with torch.enable_grad():
            for _ in range(arguments.adam_steps):
                loss = 10 * dense(scaled, z_id[None], code).abs().mean()
                adam.zero_grad()
                loss.backward()
                adam.step()

    peer = [seconds(steps) * 500 / arguments.adam_steps]
    found: list[heads.Fit] = []
    ours = [
        seconds(lambda: found.append(heads.fit_expressions(model, z_id, [points], prior=start)))
    ]
    report("fit a frame", peer, ours, f"{float(found[0].error_mm):.3f} mm by its own field")


if __name__ == "__main__":
    main()
