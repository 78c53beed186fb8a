"""Times marching cubes against scikit-image and PyMCubes, and signed distances against libigl.

    pip install scikit-image PyMCubes
    python scripts/bench/isosurface.py
    python scripts/bench/isosurface.py --size 128 --repeats 20 --threads 1

The field is the signed distance of a watertight head of the built-in face, sampled on a grid. All sides take turns
within one run; medians are printed with their ratio to this library's. Needs the package's `test` extra besides.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import igl
import mcubes
import numpy as np
import torch
from skimage.measure import marching_cubes

from freetalk import geometry
from freetalk.corpus.heads import head_model


def in_turns(sides: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Median seconds of each side, which take turns; a first round is not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in sides}
    for turn in range(repeats + 1):
        for name, run in sides.items():
            start = time.perf_counter()
            run()
            if turn:
                seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(found) for name, found in seconds.items()}


def report(title: str, seconds: dict[str, float]) -> None:
    """Prints times and their ratio to the first side."""
    print(title)
    own = next(iter(seconds.values()))
    for name, found in seconds.items():
        print(f"  {name:28s} {1e3 * found:9.2f} ms {found / own:7.2f} x", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=256, help="values along each axis")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--points", type=int, default=20_000, help="signed distances")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    model = head_model()
    vertices = model.vertices(np.zeros(len(model.identity_basis)), model.canonical_weights)
    faces = model.faces
    tree = geometry.SurfaceTree(vertices, faces)
    low, high = vertices.min(axis=0) - 0.01, vertices.max(axis=0) + 0.01
    coarse = [np.linspace(a, b, 64) for a, b in zip(low, high)]
    places = np.stack(np.meshgrid(*coarse, indexing="ij"), axis=-1)
    field = torch.from_numpy(tree.signed_distance(places.reshape(-1, 3)).reshape(1, 1, 64, 64, 64))
    fine = torch.nn.functional.interpolate(
        field.float(), size=(arguments.size,) * 3, mode="trilinear", align_corners=True
    )
    values = np.ascontiguousarray(fine[0, 0].numpy())
    found = geometry.isosurface(values)
    report(
        f"{arguments.size}^3 values, {len(found[1]):,} triangles, {torch.get_num_threads()} threads",
        in_turns(
            {
                "freetalk": lambda: geometry.isosurface(values),
                "scikit-image": lambda: marching_cubes(values, 0.0),
                "PyMCubes": lambda: mcubes.marching_cubes(values, 0.0),
            },
            arguments.repeats,
        ),
    )
    points = np.random.default_rng(0).uniform(low, high, (arguments.points, 3))
    report(
        f"{arguments.points:,} signed distances to {len(faces):,} triangles, tree built anew",
        in_turns(
            {
                "freetalk": lambda: geometry.signed_distance(vertices, faces, points),
                "libigl, fast winding number": lambda: igl.signed_distance(
                    points, vertices, faces, igl.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER
                ),
            },
            arguments.repeats,
        ),
    )


if __name__ == "__main__":
    main()
