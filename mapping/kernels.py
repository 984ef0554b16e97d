"""Gaussian kernel features phi_h(x) = exp(-gamma_h ||x - h||^2), and how far they reach.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

PREDICT_CUTOFF = 1e-7
"""Features below this are dropped while predicting: below float32 rounding of the logits."""


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
    for start, end in zip(starts, np.append(starts[1:], len(X))):
        rows = order[start:end]
        low, high = X[rows].min(0), X[rows].max(0)
        gap = np.maximum(np.maximum(low - hinges, hinges - high), 0)
        with np.errstate(over="ignore"):  # points may lie anywhere
            near = np.flatnonzero((gap**2).sum(1) < radius**2)
        yield rows, near


def cell_numbers(cell: np.ndarray) -> np.ndarray:
    """One number (N,) for each cell (N, d) >= 0, in the cells' order, however far apart they are."""
    sides = cell.max(0) + 1
    if np.prod(sides.astype(float)) < 2**62:
        return np.ravel_multi_index(tuple(cell.astype(np.int64).T), tuple(sides.astype(np.int64)))
    return np.unique(cell, axis=0, return_inverse=True)[1].reshape(-1)
