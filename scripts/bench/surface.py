"""Times the eigenbasis of a surface against robust_laplacian + scipy's eigsh, and the operator cache.

    python scripts/bench/surface.py
    python scripts/bench/surface.py --sizes 5000 50000 --repeats 5
    python scripts/bench/surface.py --sizes 1000000 --repeats 1     # a minute, 8 GB

Both sides are asked for the k smallest eigenpairs of the same Laplacian of the same mesh (the face that ships with
the package, subdivided and decimated to about the size wanted). They take turns within one run, medians are printed
with their ratio. The eigenbasis alone is then timed on one thread and on --threads in turns. Above --peer-limit vertices the peer is left out: it takes minutes there. Memory is the peak of a
process of its own that computes the operators once. Needs the package's `test` extra.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from typing import Any

import fast_simplification
import numpy as np
import robust_laplacian
import torch
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from freetalk import geometry
from freetalk.corpus import assets

Arrays = tuple[NDArray, NDArray]


def subdivide(vertices: NDArray, faces: NDArray) -> Arrays:
    """Each triangle in four."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    unique, index = np.unique(edges, axis=0, return_inverse=True)
    middle = index.reshape(-1, 3) + len(vertices)
    (a, b, c), (ab, bc, ca) = faces.T, middle.T
    corners = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    finer = np.concatenate([np.stack(corner, 1) for corner in corners])
    return np.concatenate([vertices, vertices[unique].mean(axis=1)]), finer


def head(size: int) -> Arrays:
    """An irregular mesh of the mean face with about `size` vertices."""
    vertices, faces = assets.mean_face("head")
    used, index = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used].astype(float), index.reshape(-1, 3)
    while len(vertices) < 1.5 * size:
        vertices, faces = subdivide(vertices, faces)
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces.astype(np.int32), target_count=2 * size
    )
    return points.astype(float), triangles.astype(np.int32)


def worst_residual(laplacian: Any, mass: NDArray, evals: NDArray, evecs: NDArray) -> float:
    """Largest |L φ - λ M φ| / |λ M φ| but for the first pair, whose λ is zero."""
    weighted = mass[:, None] * evecs
    residuals = np.linalg.norm(laplacian @ evecs - weighted * evals, axis=0)
    scale = np.abs(evals) * np.linalg.norm(weighted, axis=0)
    return float((residuals / scale)[1:].max())


def peer(vertices: NDArray, faces: NDArray, k: int) -> float:
    """robust_laplacian + eigsh: the worst residual."""
    laplacian, mass = robust_laplacian.mesh_laplacian(vertices, faces)
    evals, evecs = eigsh(laplacian, k, mass, sigma=1e-8)
    return worst_residual(laplacian, mass.diagonal(), evals, evecs)


def ours(vertices: NDArray, faces: NDArray, k: int) -> float:
    """The same with this library: the worst residual it states."""
    laplacian, mass = geometry.robust_laplacian(vertices, faces)
    return float(geometry.eigenbasis(laplacian, mass, k, progress=False).residuals.max())


def ours_cotan(vertices: NDArray, faces: NDArray, k: int) -> float:
    """As `ours`, with the cotangent Laplacian."""
    laplacian = geometry.cotan_laplacian(vertices, faces)
    mass = geometry.lumped_mass(vertices, faces)
    return float(geometry.eigenbasis(laplacian, mass, k, progress=False).residuals.max())


def in_turns(sides: dict[str, Callable[[], float]], repeats: int) -> dict[str, tuple[float, float]]:
    """Median seconds and largest residual of each side, which take turns."""
    seconds: dict[str, list[float]] = {name: [] for name in sides}
    worst = dict.fromkeys(sides, 0.0)
    for _ in range(repeats):
        for name, run in sides.items():
            start = time.perf_counter()
            residual = run()
            seconds[name].append(time.perf_counter() - start)
            worst[name] = max(worst[name], residual)
    return {name: (statistics.median(seconds[name]), worst[name]) for name in sides}


def compute_once(vertices: NDArray, faces: NDArray, k: int) -> tuple[float, float]:
    """Seconds of all operators, and this process's peak memory in GB."""
    start = time.perf_counter()
    geometry.surface_operators(vertices, faces, k, cache=False, progress=False)
    elapsed = time.perf_counter() - start
    return elapsed, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


def cache_hit(vertices: NDArray, faces: NDArray, k: int) -> float:
    """Median seconds of operators that are in the cache."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = []
        for _ in range(12):
            start = time.perf_counter()
            geometry.surface_operators(vertices, faces, k, folder, progress=False)
            seconds.append(time.perf_counter() - start)
        return statistics.median(seconds[1:])


def bench(size: int, k: int, repeats: int, peer_limit: int) -> None:
    vertices, faces = head(size)
    print(f"{len(vertices):,} vertices, {len(faces):,} faces, k = {k}", flush=True)
    sides: dict[str, Callable[[], float]] = {}
    if len(vertices) <= peer_limit:
        sides["robust_laplacian + eigsh"] = lambda: peer(vertices, faces, k)
    sides["freetalk, robust"] = lambda: ours(vertices, faces, k)
    sides["freetalk, cotan"] = lambda: ours_cotan(vertices, faces, k)
    results = in_turns(sides, repeats)
    reference = results.get("robust_laplacian + eigsh")
    for name, (seconds, residual) in results.items():
        ratio = f"{seconds / reference[0]:8.2f} x" if reference else " " * 10
        print(f"  {name:26s} {seconds:8.3f} s {ratio}   residual {residual:.1e}", flush=True)
    threads = torch.get_num_threads()
    if threads > 1:
        laplacian, mass = geometry.robust_laplacian(vertices, faces)

        def on(count: int) -> float:
            torch.set_num_threads(count)
            return float(geometry.eigenbasis(laplacian, mass, k, progress=False).residuals.max())

        scaling = in_turns({"one": lambda: on(1), "all": lambda: on(threads)}, repeats)
        one, every = scaling["one"][0], scaling["all"][0]
        label = f"eigenbasis, 1 -> {threads} threads"
        print(f"  {label:26s} {one:8.3f} -> {every:.3f} s, {one / every:.2f} x", flush=True)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        seconds, gigabytes = pool.apply(compute_once, (vertices, faces, k))
    print(f"  {'all operators, once':26s} {seconds:8.3f} s              peak {gigabytes:.2f} GB")
    print(f"  {'operators from the cache':26s} {1e3 * cache_hit(vertices, faces, k):8.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", default=[5_000, 50_000, 200_000])
    parser.add_argument("--k", type=int, default=128, help="eigenpairs")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--peer-limit", type=int, default=100_000, help="vertices")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    for size in arguments.sizes:
        bench(size, arguments.k, arguments.repeats, arguments.peer_limit)


if __name__ == "__main__":
    main()
