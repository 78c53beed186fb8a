"""One OpenMP runtime in a process, and parallel loops that work in the fork of a DataLoader's worker."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from freetalk import geometry

RUNTIMES = r"""
import re
import freetalk

with open("/proc/self/maps") as maps:
    print(*sorted(set(re.findall(r"\S*/lib(?:gomp|iomp5|omp)\b\S*\.so\S*", maps.read()))))
"""


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc/self/maps")
@pytest.mark.slow
def test_the_process_has_one_openmp_runtime() -> None:
    # A fresh interpreter: other packages that the tests import may bring a runtime of their own.
    result = subprocess.run(
        [sys.executable, "-c", RUNTIMES], capture_output=True, text=True, check=True
    )
    assert len(result.stdout.split()) == 1, result.stdout


def eigenvalues(size: int) -> NDArray[np.float64]:
    """Of a grid's Laplacian, whose basis is computed in parallel loops of ours and nothing of torch's."""
    path = sp.diags_array([-np.ones(size - 1), np.ones(size - 1)], offsets=[-1, 1])
    chain = sp.diags_array(abs(path).sum(axis=1)) - abs(path)
    grid = sp.kronsum(chain, chain).tocsc()
    return geometry.eigenbasis(grid, np.ones(size**2), k=12, solver="block").evals


class Grids(Dataset[NDArray[np.float64]]):
    """Eigenvalues of a grid, computed where the item is asked for."""

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> NDArray[np.float64]:
        torch.set_num_threads(4)  # DataLoader sets one, with which no loop tries to be parallel
        return eigenvalues(60 + index)


def test_parallel_loops_work_in_the_fork_of_a_data_loader() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    try:
        here = [
            eigenvalues(60 + index) for index in range(4)
        ]  # starts the threads that a fork loses
        loader = DataLoader(
            Grids(), batch_size=None, num_workers=2, multiprocessing_context="fork", timeout=120
        )
        there = list(loader)
    finally:
        torch.set_num_threads(before)
    for own, forked in zip(here, there, strict=True):
        assert np.array_equal(own, forked)
