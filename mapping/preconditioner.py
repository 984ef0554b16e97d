"""Coordinates in which overlapping kernels look independent: a sparse approximate Cholesky factor.

Knows a Gram matrix and where its rows lie; knows nothing of classes or losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

NEIGHBOURS = 24
"""Earlier hinge points each row of the factor couples to; 64 saves one step in ten and costs five times more."""


@dataclass(frozen=True)
class SparseFactor:
    """G, sparse and lower triangular, with G A G^T near the identity for a symmetric positive A (H, H).

    Each row of G solves a small dense system with its nearest earlier neighbours (Vecchia 1988; Kaporin
    1994), so building and applying it is linear in H, unlike a Cholesky factor of A.
    columns, values: (H, m); row_index, row_value, starts: the transpose, sorted by column.
    """

    columns: torch.Tensor
    values: torch.Tensor
    row_index: torch.Tensor
    row_value: torch.Tensor
    starts: torch.Tensor

    def pull(self, gradient: torch.Tensor) -> torch.Tensor:
        """G g: gradient by the weights (H, C) to gradient by the new coordinates (H, C)."""
        return torch.nn.functional.embedding_bag(
            self.columns, gradient, mode="sum", per_sample_weights=self.values
        )

    def push(self, step: torch.Tensor) -> torch.Tensor:
        """G^T u: a step in the new coordinates (H, C) to a step in the weights (H, C)."""
        return torch.nn.functional.embedding_bag(
            self.row_index, step, self.starts, mode="sum", per_sample_weights=self.row_value
        )


def sparse_factor(gram: torch.Tensor, places: np.ndarray) -> SparseFactor:
    """Factor of the symmetric positive `gram` (H, H); places: (H, d) positions that say which rows couple."""
    count = len(places)
    rank = np.random.default_rng(0).permutation(count)  # a random order spreads the error evenly
    candidates = min(3 * NEIGHBOURS, count)
    near = cKDTree(places).query(places, candidates)[1].reshape(count, candidates)
    earlier = rank[near] < rank[:, None]
    # The nearest NEIGHBOURS earlier rows, the row itself last; -1 pads.
    order = np.argsort(~earlier, axis=1, kind="stable")[:, :NEIGHBOURS]
    chosen = np.where(np.take_along_axis(earlier, order, 1), np.take_along_axis(near, order, 1), -1)
    pattern = torch.from_numpy(np.column_stack([chosen, np.arange(count)])).to(gram.device)
    valid = pattern >= 0
    index = pattern.clamp_min(0)
    local = gram[index[:, :, None], index[:, None, :]]
    local = local * (valid[:, :, None] & valid[:, None, :])
    local.diagonal(dim1=1, dim2=2).add_((~valid).to(local.dtype))
    factor = torch.linalg.cholesky(local)
    unit = torch.zeros(count, index.shape[1], 1, device=gram.device)
    unit[:, -1, 0] = 1 / factor[:, -1, -1]
    # Last column of the local inverse, scaled to a unit diagonal of G A G^T. Triangular solves only:
    # batched LU is wrong in torch 2.13 with two threads.
    column = torch.linalg.solve_triangular(factor.mT, unit, upper=True)[..., 0]
    values = (column / column[:, -1:].sqrt()) * valid
    by_column = torch.sort(index.reshape(-1), stable=True)
    counts = torch.bincount(by_column.values, minlength=count)
    rows = torch.div(by_column.indices, index.shape[1], rounding_mode="floor")
    return SparseFactor(
        columns=index.int(),
        values=values,
        row_index=rows.int(),
        row_value=values.reshape(-1)[by_column.indices],
        starts=(counts.cumsum(0) - counts).int(),
    )


@dataclass(frozen=True)
class DiagonalFactor:
    """G = diag(scale), for Gram matrices too large to hold. scale: (H, 1)."""

    scale: torch.Tensor

    def pull(self, gradient: torch.Tensor) -> torch.Tensor:
        """G g."""
        return self.scale * gradient

    push = pull
