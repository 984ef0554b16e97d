"""Truncated kernel features as sparse matrices, for fitting.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.hinge_cells import HingeCells, Tables, hinge_cells, pairs_in_reach
from mapping.kernels import blocks, cell_numbers, dense_features, groups_of_width, reach
from mapping.sparse_rows import SparseRows
from mapping.threads import map_in_threads

CANDIDATES = 2**18
"""Pairs of a point and a hinge point that are looked at in one go: they fit the processor's cache."""
LOCAL = 0.5
"""Points within a cell of this size follow each other, in units of the widest kernel's reach."""

RowsOfPart = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""Rows of some points: their indices (n,) and lengths (n,); the rows' columns and values (nnz,)."""


@dataclass(frozen=True)
class SparseFeatures:
    """Truncated features of N points.

    order: (N,) the row's index in the caller's array (rows are sorted by block for locality); strongest:
    (N,) largest feature of each row; hinge_count: columns, one a hinge point.
    """

    order: torch.Tensor
    strongest: torch.Tensor
    rows: SparseRows
    hinge_count: int

    def times(self, W: torch.Tensor) -> torch.Tensor:
        """Phi W: (H, C) -> (N, C)."""
        return self.rows.times(W)


def sparse_features(
    X: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
    cutoff: float,
    device: torch.device,
) -> SparseFeatures:
    """Truncated features of X (N, d); each row keeps the hinges whose feature exceeds `cutoff`."""
    cells = hinge_cells(hinges, gamma, cutoff)
    if cells is None:
        parts = _by_width(X, hinges, gamma, cutoff)
    else:
        parts = _by_cells(X, cells, float(reach(gamma.min(), cutoff)), cutoff)
    order, length, column, value = (torch.cat(part) for part in zip(*parts))
    ends = np.append(0, np.cumsum(length.numpy())).astype(np.int32)
    strongest = np.zeros(len(order), np.float32)
    filled = length.numpy() > 0
    strongest[filled] = np.maximum.reduceat(value.numpy(), ends[:-1][filled])
    return SparseFeatures(
        order.to(device),
        torch.from_numpy(strongest).to(device),
        SparseRows(*(t.to(device) for t in (torch.from_numpy(ends[:-1]), column, value))),
        len(hinges),
    )


def _by_width(X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> list[RowsOfPart]:
    """Rows found by search; for each width alone where widths differ much, by trees of points."""
    groups = groups_of_width(gamma)
    if len(groups) == 1:
        return _by_search(X, hinges, gamma, cutoff)
    from scipy import sparse  # here, since both would add to the cost of importing the map
    from scipy.spatial import cKDTree

    narrowest = float(reach(gamma.max(), cutoff))
    order = np.argsort(cell_numbers(np.floor((X - X.min(0)) / narrowest)), kind="stable")
    points = cKDTree(X[order])

    def pairs_of(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        width = float(gamma[chosen[0]])
        found = points.sparse_distance_matrix(
            cKDTree(hinges[chosen]), float(reach(width, cutoff)), output_type="ndarray"
        )
        return found["i"], chosen[found["j"]], np.exp(-width * found["v"] ** 2).astype(np.float32)

    rows, columns, values = (np.concatenate(part) for part in zip(*map_in_threads(pairs_of, groups)))
    table = sparse.coo_matrix((values, (rows, columns)), (len(X), len(hinges))).tocsr()
    arrays = order, np.diff(table.indptr), table.indices.astype(np.int32), table.data
    return [tuple(torch.from_numpy(a) for a in arrays)]  # type: ignore[list-item]


def _by_search(X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> list[RowsOfPart]:
    """Rows of compact groups of points, each with all hinge points in the group's reach."""
    X_t, hinges_t, gamma_t = (torch.from_numpy(a) for a in (X, hinges, gamma))

    def rows_of(block: tuple[np.ndarray, np.ndarray]) -> RowsOfPart:
        rows, near = torch.from_numpy(block[0]), torch.from_numpy(block[1])
        phi = dense_features(X_t[rows], hinges_t[near], gamma_t[near])
        kept = phi > cutoff
        return rows, kept.sum(1), near[kept.nonzero()[:, 1]].int(), phi[kept]

    return map_in_threads(rows_of, blocks(X, hinges, gamma, cutoff))


def _by_cells(X: np.ndarray, cells: list[HingeCells], radius: float, cutoff: float) -> list[RowsOfPart]:
    """The same from tables of cells: ten times as fast, since few pairs are out of reach."""
    tables, size = Tables.of(cells, cutoff), 0
    cell_of, terms_of = zip(*(table.locate(X) for table in cells))
    cell = np.stack(cell_of, 1)
    for column, table in zip(cell.T, cells):
        column[column >= 0] += size
        size += len(table.ids)
    # Points that are reached by the same widths go together, and of them those that are near each other.
    kind = (cell >= 0) @ (1 << np.arange(len(cells)))
    place = np.floor((X - X.min(0)) / (LOCAL * radius))
    order = np.lexsort((cell_numbers(place), kind))
    cell, terms = cell[order], np.stack(terms_of, 1)[order]

    def rows_of(part: slice) -> RowsOfPart:
        length, column, exponent = pairs_in_reach(cell[part], terms[part], tables)
        arrays = order[part], length, column, np.exp(exponent, out=exponent)
        return tuple(torch.from_numpy(a) for a in arrays)  # type: ignore[return-value]

    step = max(1, CANDIDATES // int(tables.starts[-1]))
    return map_in_threads(rows_of, [slice(a, a + step) for a in range(0, len(X), step)])
