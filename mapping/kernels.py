"""Gaussian kernel features phi_h(x) = exp(-gamma_h ||x - h||^2), dense and truncated.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from mapping.threads import map_in_threads

FIT_CUTOFF = 3e-3
"""Features below this are dropped while fitting: 20-45 of thousands remain a row."""
PREDICT_CUTOFF = 1e-7
"""Features below this are dropped while predicting: below float32 rounding of the logits."""


@dataclass(frozen=True)
class SparseRows:
    """Rows of a sparse matrix. offsets: (rows,) start of each; columns: (nnz,); values: (nnz,) float32."""

    offsets: torch.Tensor
    columns: torch.Tensor
    values: torch.Tensor

    def times(self, table: torch.Tensor) -> torch.Tensor:
        """This matrix times a dense table (columns, C): (rows, C)."""
        # embedding_bag is the fastest sparse-times-dense product of torch on a CPU and runs on CUDA as well.
        return torch.nn.functional.embedding_bag(
            self.columns, table, self.offsets, mode="sum", per_sample_weights=self.values
        )

    def part(self, rows: slice) -> SparseRows:
        """Some consecutive rows, without a copy of their values."""
        last = int(self.offsets[rows.stop]) if rows.stop < len(self.offsets) else len(self.columns)
        first = int(self.offsets[rows.start]) if rows.start < len(self.offsets) else last
        return SparseRows(self.offsets[rows] - first, self.columns[first:last], self.values[first:last])


@dataclass(frozen=True)
class SparseFeatures:
    """Truncated features of N points and, for gradients, their transpose.

    order: (N,) the row's index in the caller's array (rows are sorted by block for locality); strongest:
    (N,) largest feature of each row.
    """

    order: torch.Tensor
    strongest: torch.Tensor
    rows: SparseRows
    transposed: SparseRows

    def times(self, W: torch.Tensor) -> torch.Tensor:
        """Phi W: (H, C) -> (N, C)."""
        return self.rows.times(W)

    def transpose_times(self, R: torch.Tensor) -> torch.Tensor:
        """Phi^T R: (N, C) -> (H, C)."""
        return self.transposed.times(R)

    def squared_column_sums(self, row_weights: torch.Tensor) -> torch.Tensor:
        """sum_i w_i phi_ih^2 for each hinge: (N,) -> (H,)."""
        squared = replace(self.transposed, values=self.transposed.values.square())
        return squared.times(row_weights[:, None])[:, 0]


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
    radius = reach(gamma, cutoff).astype(np.float32)
    size = 1.5 * float(radius.max())
    cell = np.floor((X - X.min(0)) / size).astype(np.int64)
    key = np.ravel_multi_index(tuple(cell.T), tuple(cell.max(0) + 1))
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    for start, end in zip(starts, np.append(starts[1:], len(X))):
        rows = order[start:end]
        low, high = X[rows].min(0), X[rows].max(0)
        gap = np.maximum(np.maximum(low - hinges, hinges - high), 0)
        yield rows, np.flatnonzero((gap**2).sum(1) < radius**2)


def sparse_features(
    X: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
    cutoff: float,
    device: torch.device,
) -> SparseFeatures:
    """Truncated features of X (N, d); each row keeps the hinges whose feature exceeds `cutoff`."""
    from scipy import sparse  # here, since it would add to the cost of importing the map

    X_t, hinges_t = torch.from_numpy(X), torch.from_numpy(hinges)
    gamma_t = torch.from_numpy(gamma)

    def rows_of(block: tuple[np.ndarray, np.ndarray]) -> tuple[torch.Tensor, ...]:
        rows, near = torch.from_numpy(block[0]), torch.from_numpy(block[1])
        phi = dense_features(X_t[rows], hinges_t[near], gamma_t[near])
        kept = phi > cutoff
        strongest = phi.amax(1) if len(near) else torch.zeros(len(rows))
        return rows, strongest, kept.sum(1), near[kept.nonzero()[:, 1]].int(), phi[kept]

    parts = zip(*map_in_threads(rows_of, blocks(X, hinges, gamma, cutoff)))
    order, strongest, length, column, value = (torch.cat(part) for part in parts)
    offsets = (length.cumsum(0) - length).int()
    ends = np.append(offsets.numpy(), len(value))
    shape = (len(order), len(hinges))
    transposed = sparse.csr_matrix((value.numpy(), column.numpy(), ends), shape).tocsc()
    csc = (transposed.indptr[:-1].astype(np.int32), transposed.indices.astype(np.int32), transposed.data)
    return SparseFeatures(
        order.to(device),
        strongest.to(device),
        SparseRows(*(t.to(device) for t in (offsets, column, value))),
        SparseRows(*(torch.from_numpy(a).to(device) for a in csc)),
    )
