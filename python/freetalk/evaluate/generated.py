"""Scores of generated pictures as a set: Fréchet and kernel distances of their features.

Features are anybody's: of Inception or CLIP over rendered frames for the published FID and KID, or a user's network.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]
#: (H, W, 3) uint8 pictures to (N, D) features.
Features = Callable[[list[npt.NDArray[np.uint8]]], Array]

_CHUNK = 64


def features_of(
    pictures: Iterable[npt.NDArray[np.uint8]], network: Features, batch: int = _CHUNK
) -> npt.NDArray[np.float64]:
    """Features (N, D) of pictures, a batch at a time.

    Args:
        pictures: (H, W, 3) uint8, such as rendered frames.
        network: features (B, D) of a list of them.
        batch: pictures that the network sees at once.

    Raises:
        ValueError: no pictures, or features of another shape.
    """
    rows: list[Array] = []
    waiting: list[npt.NDArray[np.uint8]] = []

    def flush() -> None:
        found = np.asarray(network(waiting), np.float64)
        if found.ndim != 2 or len(found) != len(waiting):
            raise ValueError(f"features of {len(waiting)} pictures have the shape {found.shape}")
        rows.append(found)
        waiting.clear()

    for picture in pictures:
        waiting.append(picture)
        if len(waiting) == batch:
            flush()
    if waiting:
        flush()
    if not rows:
        raise ValueError("there are no pictures to take features of")
    return np.concatenate(rows)


def frechet_distance(first: Array, second: Array) -> float:
    """Fréchet distance of two sets of features as Gaussians, FID where they are Inception's [Heusel et al. 2017].

    |m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)), the trace of the root from the singular values of the product of
    centred features, which needs no matrix root and is right for fewer rows than channels.

    Args:
        first: (N, D) features.
        second: (M, D) features.

    Raises:
        ValueError: shapes that do not fit, or fewer than two rows.
    """
    a, b = _two_sets(first, second)
    centred = [(x - x.mean(axis=0)) / np.sqrt(len(x) - 1) for x in (a, b)]
    between = float(np.square(a.mean(axis=0) - b.mean(axis=0)).sum())
    spread = sum(float(np.square(x).sum()) for x in centred)
    root = float(np.linalg.svd(centred[0] @ centred[1].T, compute_uv=False).sum())
    return max(between + spread - 2 * root, 0.0)


def kernel_distance(first: Array, second: Array) -> float:
    """Kernel distance, KID where features are Inception's: unbiased MMD^2 under (x.y / D + 1)^3 [Binkowski et al. 2018].

    Args:
        first: (N, D) features.
        second: (M, D) features.

    Raises:
        ValueError: shapes that do not fit, or fewer than two rows.
    """
    a, b = _two_sets(first, second)

    def kernel(x: Array, y: Array) -> npt.NDArray[np.float64]:
        return (x @ y.T / x.shape[1] + 1) ** 3

    def within(x: Array) -> float:
        values = kernel(x, x)
        return float((values.sum() - np.trace(values)) / (len(x) * (len(x) - 1)))

    return within(a) + within(b) - 2 * float(kernel(a, b).mean())


def _two_sets(
    first: Array, second: Array
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    a, b = np.asarray(first, np.float64), np.asarray(second, np.float64)
    if a.ndim != 2 or b.ndim != 2 or a.shape[1] != b.shape[1] or min(len(a), len(b)) < 2:
        raise ValueError(
            f"features must be (N, D) and (M, D) of at least 2 rows, found {a.shape} and {b.shape}"
        )
    return a, b
