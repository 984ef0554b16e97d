"""Gaussian kernel features phi_h(x) = exp(-gamma_h ||x - h||^2), dense and truncated.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from mapping.threads import map_in_threads

FIT_CUTOFF = 3e-3
"""Features below this are dropped while fitting: 20-45 of thousands remain a row."""
PREDICT_CUTOFF = 1e-7
"""Features below this are dropped while predicting: below float32 rounding of the logits."""


@dataclass(frozen=True)
class SparseFeatures:
    """Rows of truncated features in CSR form and, for gradients, the transpose.

    order: (N,) the row's index in the caller's array (rows are sorted by block for locality).
    """

    order: torch.Tensor
    strongest: torch.Tensor  # (N,) largest feature of each row
    offsets: torch.Tensor  # (N,) start of each row
    columns: torch.Tensor  # (nnz,) hinge index
    values: torch.Tensor  # (nnz,) float32
    transposed_offsets: torch.Tensor  # (H,)
    transposed_columns: torch.Tensor  # (nnz,) row index
    transposed_values: torch.Tensor  # (nnz,)

    def times(self, W: torch.Tensor) -> torch.Tensor:
        """Phi W: (H, C) -> (N, C)."""
        return _bag(W, self.columns, self.offsets, self.values)

    def transpose_times(self, R: torch.Tensor) -> torch.Tensor:
        """Phi^T R: (N, C) -> (H, C)."""
        return _bag(R, self.transposed_columns, self.transposed_offsets, self.transposed_values)

    def squared_column_sums(self, row_weights: torch.Tensor) -> torch.Tensor:
        """sum_i w_i phi_ih^2 for each hinge: (N,) -> (H,)."""
        squared = self.transposed_values.square()
        return _bag(row_weights[:, None], self.transposed_columns, self.transposed_offsets, squared)[:, 0]


def _bag(
    table: torch.Tensor, columns: torch.Tensor, offsets: torch.Tensor, values: torch.Tensor
) -> torch.Tensor:
    # embedding_bag is the fastest sparse-times-dense product of torch on a CPU and runs on CUDA as well.
    return torch.nn.functional.embedding_bag(
        columns, table, offsets, mode="sum", per_sample_weights=values, include_last_offset=False
    )


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
    tensors = (
        order,
        strongest,
        offsets,
        column,
        value,
        torch.from_numpy(transposed.indptr[:-1].astype(np.int32)),
        torch.from_numpy(transposed.indices.astype(np.int32)),
        torch.from_numpy(transposed.data),
    )
    return SparseFeatures(*(t.to(device) for t in tensors))
