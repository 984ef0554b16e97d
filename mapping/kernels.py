"""Gaussian kernel features phi_h(x) = exp(-gamma_h ||x - h||^2), and how far they reach.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

PREDICT_CUTOFF = 1e-7
"""Features below this are dropped while predicting: below float32 rounding of the logits."""
APART = 4.0
"""Kernels are looked at width by width when the largest gamma is this many times the smallest."""
MOST_WIDTHS = 8
"""More widths than this are not looked at one by one."""
TOGETHER = 32
"""Groups of points that follow each other, whose hinge points are looked for together first."""


def dense_features(X: torch.Tensor, hinges: torch.Tensor, gamma: torch.Tensor) -> torch.Tensor:
    """exp(-gamma_h ||x - h||^2) for X (N, d), hinges (H, d), gamma (H,) -> (N, H)."""
    # -gamma (|x|^2 - 2 x.h + |h|^2) as one matrix product; about the points' middle, where the squares are
    # small enough for float32 to lose nothing that matters.
    middle = X.mean(0)
    X, hinges = X - middle, hinges - middle
    left = torch.cat([X, X.square().sum(1, keepdim=True), torch.ones_like(X[:, :1])], 1)
    right = torch.cat([2 * hinges, -torch.ones_like(hinges[:, :1]), -hinges.square().sum(1, keepdim=True)], 1)
    return (left @ (right * gamma[:, None]).T).exp_()


def reach(gamma: np.ndarray | float, cutoff: float) -> np.ndarray:
    """Distance beyond which a feature is below `cutoff`."""
    return np.sqrt(-np.log(cutoff) / np.asarray(gamma))


def blocks(
    X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray, cutoff: float
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Split points into compact groups: yields (indices into X, indices of the hinges in reach)."""
    if len(X) == 0:
        return
    radius = reach(gamma, cutoff).astype(np.float32)
    size = 1.5 * float(radius.max())
    key = cell_numbers(np.floor((X - X.min(0)) / size))
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    ends = np.append(starts[1:], len(X))
    # Hinge points are looked for in two steps, near a row of groups and then near each group: with many
    # groups and many hinge points, all pairs of them would take longer than the features.
    for first in range(0, len(starts), TOGETHER):
        part = order[starts[first] : ends[min(first + TOGETHER, len(starts)) - 1]]
        around = _within(X[part], hinges, radius)
        near_hinges, near_radius = hinges[around], radius[around]
        for start, end in zip(starts[first : first + TOGETHER], ends[first : first + TOGETHER]):
            rows = order[start:end]
            yield rows, around[_within(X[rows], near_hinges, near_radius)]


def _within(X: np.ndarray, hinges: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Indices of the hinge points (H, d) closer than their radius (H,) to the box around points (N, d)."""
    gap = np.maximum(np.maximum(X.min(0) - hinges, hinges - X.max(0)), 0)
    with np.errstate(over="ignore"):  # points may lie anywhere
        return np.flatnonzero((gap**2).sum(1) < radius**2)


def groups_of_width(gamma: np.ndarray) -> list[np.ndarray]:
    """Indices of hinge points, apart by width where widths differ so much that groups of points fit for the
    wide kernels would be compared with far too many narrow ones; else all of them together."""
    widths = np.unique(gamma)
    if len(widths) > MOST_WIDTHS or not len(widths) or widths[-1] < APART * widths[0]:
        return [np.arange(len(gamma))]
    return [np.flatnonzero(gamma == width) for width in widths]


def cell_numbers(cell: np.ndarray) -> np.ndarray:
    """One number (N,) for each cell (N, d) >= 0, in the cells' order, however far apart they are."""
    sides = cell.max(0) + 1
    if np.prod(sides.astype(float)) < 2**62:
        return np.ravel_multi_index(tuple(cell.astype(np.int64).T), tuple(sides.astype(np.int64)))
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
