"""Noise samples in a lattice's cells around data: in a cell the same ones, whatever other cells there are.

Knows points and cells in space; must not know classes, kernels or what the samples are for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapping.hashed_hinges import filled_nodes
from mapping.kernels import cell_numbers

MOST_EACH = 2**20
"""Samples in a cell are drawn with seeds from one on, less than so many."""


def cells_around(X: np.ndarray, cell: np.ndarray, around: Sequence[int] = (1, 1, 1)) -> np.ndarray:
    """Numbers (M, 3) int64 of the cells (3,) [m] that hold points X (N, 3), and of so many around them along
    each axis."""
    steps = np.stack(np.meshgrid(*[np.arange(-n, n + 1) for n in around]), -1).reshape(-1, 3)
    return filled_nodes((filled_nodes(X, cell)[:, None] + steps).reshape(-1, 3), 1.0)


def noise_in(cells: np.ndarray, cell: np.ndarray, each: float, seed: int) -> np.ndarray:
    """Points (M, 3), on average `each` in every one of the cells (L, 3) of size (3,) [m]; in a cell the same
    whatever others there are."""
    parts = [np.empty((0, 3))]
    for repeat in range(int(np.ceil(each))):
        chance = _chances(cells, seed + repeat)
        kept = chance[:, 3] < each - repeat
        parts.append((cells[kept] + chance[kept, :3] - 0.5) * cell)
    return np.concatenate(parts)


def lie_in(X: np.ndarray, cells: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(N,) whether points X (N, 3) lie in one of the cells (L, 3) of size (3,) [m]."""
    every = np.concatenate([np.rint(X / cell).astype(np.int64), cells])
    numbers = cell_numbers(every - every.min(axis=0))
    return np.isin(numbers[: len(X)], numbers[len(X) :])


def _chances(cells: np.ndarray, seed: int) -> np.ndarray:
    """Numbers (M, 4) in [0, 1) of cells (M, 3), even and unrelated: splitmix64, seeded by the cells."""
    state = np.full(len(cells), seed, np.uint64)
    out = np.empty((len(cells), 4))
    with np.errstate(over="ignore"):
        for step in range(7):
            if step < 3:
                state ^= cells[:, step].astype(np.uint64)
            state += np.uint64(0x9E3779B97F4A7C15)
            mixed = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            mixed ^= mixed >> np.uint64(31)
            if step < 3:
                state = mixed
            else:
                out[:, step - 3] = (mixed >> np.uint64(11)) * 2.0**-53
    return out
