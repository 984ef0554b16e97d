"""How well labels agree with those of the points around them.

Knows points in R^d and labels; must not know kernels or what a class means.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mapping.distinct import distinct
from mapping.kernels import cell_numbers

FEWEST = 4
"""Cells with fewer points say nothing about wrong labels."""


def disagreement(X: np.ndarray, y: np.ndarray, size: float) -> np.ndarray:
    """(N,) share of the other points in a point's cell of `size` that have another label; 0 if alone."""
    _, cell, pair, counts, pairs = _counted(X, y, size)
    others = counts[cell] - 1
    return np.where(others > 0, (counts[cell] - pairs[pair]) / np.maximum(others, 1), 0.0)


def wrong_label_share(X: np.ndarray, y: np.ndarray, sizes: Sequence[float]) -> float:
    """Share of the points (N, d) whose label (N,) is not the commonest one of their cubic cell.

    sizes: of the cells, small to large; the first counts that puts half of the points into cells with FEWEST
    others, or more. 0 where none does: larger cells hold several things, which is no error of the labels.
    """
    for size in sizes:
        cells, cell, pair, counts, pairs = _counted(X, y, size)
        full = counts >= FEWEST
        if counts[full].sum() >= len(X) / 2:
            most = np.zeros(cells, np.int64)
            np.maximum.at(most, cell, pairs[pair])
            return float(1 - most[full].sum() / counts[full].sum())
    return 0.0


def true_labels(y: np.ndarray, shares: np.ndarray, wrong: float) -> np.ndarray:
    """(N, C) probability of each class, given the label y (N,) and what a map makes of the place, shares
    (N, C): by Bayes' rule where a share `wrong` of the labels became any other class alike."""
    classes = shares.shape[1]
    seen = np.full_like(shares, wrong / max(classes - 1, 1))
    seen[np.arange(len(y)), y] = 1 - wrong
    joint = shares * seen
    return joint / joint.sum(axis=1, keepdims=True)


def _counted(
    X: np.ndarray, y: np.ndarray, size: float
) -> tuple[int, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Number of cells; each point's cell (N,) and its pair of cell and label (N,); points in each of both."""
    place = np.floor(X / size)
    _, cell = distinct(cell_numbers(place - place.min(0)))
    _, pair = distinct(cell * (int(y.max()) + 1) + y)
    counts, pairs = np.bincount(cell), np.bincount(pair)
    return len(counts), cell, pair, counts, pairs
