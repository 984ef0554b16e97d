"""Samples as the fit of a map with kernels of several shapes sees them: features, weights, and their order.

Knows points, weights and hinge points; must not know what a class means.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch

from mapping.config import FitConfig
from mapping.hashed_hinges import HashedHinges, features_at, order_of
from mapping.preconditioner import SparseFactor, sparse_factor
from mapping.softmax import FitReport, fit_softmax
from mapping.sparse_features import SparseFeatures
from mapping.sparse_rows import SparseRows

REACHED = 0.05
"""A sample whose strongest feature is below this is out of the hinge points' reach."""


@dataclass(frozen=True)
class WeighedFeatures:
    """features: rows in their own order; weights: (N,) of the rows, 1 in sum; total: what that sum was;
    hinges: their columns."""

    features: SparseFeatures
    weights: torch.Tensor
    total: float
    hinges: HashedHinges

    @classmethod
    def of(
        cls, X: np.ndarray, weights: np.ndarray, noise: np.ndarray, hinges: HashedHinges
    ) -> WeighedFeatures:
        """Of data X (n, 3) with weights (n,), then noise (m, 3), each of weight 1."""
        every = np.concatenate([X, noise])
        order = order_of(every, hinges)
        ends, columns, values, strongest = features_at(every[order], hinges)
        rows = SparseRows(*(torch.from_numpy(part) for part in (ends[:-1], columns, values)))
        weight = np.append(weights, np.ones(len(noise)))[order]
        # Noise out of reach is "uncertain" in any case, and would drive the outermost weights up.
        weight[strongest <= REACHED] = 0
        found = SparseFeatures(
            torch.from_numpy(order), torch.from_numpy(strongest), rows, int(hinges.first[-1])
        )
        total = float(weight.sum())
        return cls(found, torch.from_numpy((weight / total).astype(np.float32)), total, hinges)

    @property
    def count(self) -> int:
        """Number of samples, noise included."""
        return len(self.weights)

    def fit(
        self, target: np.ndarray, offset: np.ndarray, l2: float, config: FitConfig
    ) -> tuple[np.ndarray, FitReport]:
        """Weights (H, C) that explain targets (N, C), shares of the classes, in the caller's order.

        l2: penalty beside the sum over the samples as they were weighed, so that parts and wholes agree.
        """
        W, report = fit_softmax(
            self.features,
            torch.from_numpy(target)[self.features.order],
            self.weights,
            torch.from_numpy(offset),
            lambda diagonal: _factor(diagonal, self.hinges),
            l2 / self.total,
            config,
        )
        return W.numpy(), report

    def times(self, W: np.ndarray) -> torch.Tensor:
        """Features times W (H, C): (N, C), in the caller's order."""
        out = torch.empty(self.count, W.shape[1])
        out[self.features.order] = self.features.times(torch.from_numpy(W))
        return out


def _factor(diagonal: torch.Tensor, hinges: HashedHinges) -> SparseFactor:
    """Coordinates in which the kernels of each shape look independent; shapes are not coupled."""
    columns, values = [], []
    for start, stop in pairwise(hinges.first.tolist()):
        nodes = (hinges.nodes[start:stop] - hinges.nodes[start:stop].min(0)).astype(np.float32)
        width = np.full(len(nodes), hinges.width, np.float32)
        lower = sparse_factor(diagonal[start:stop], nodes, width).lower
        columns.append(lower.columns + start)
        values.append(lower.values)
    column = torch.cat(columns)
    each = len(column) // len(diagonal)
    offsets = torch.arange(0, len(column), each, dtype=torch.int32)
    whole = SparseRows(offsets, column, torch.cat(values))
    return SparseFactor(whole, whole.transposed(len(diagonal)))
