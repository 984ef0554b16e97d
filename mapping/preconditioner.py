"""Coordinates in which overlapping kernels look independent: a sparse approximate Cholesky factor.

Knows hinge points and widths; knows nothing of samples' classes or losses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from mapping.compiled import compiled
from mapping.hinge_nodes import HingeNodes, nearest_earlier
from mapping.sparse_rows import SparseRows
from mapping.threads import Threads

NEIGHBOURS = 5
"""Earlier hinge points each row of the factor couples to; more cost several times as much for no gain."""
RIDGE = 1e-3
"""Added to the unit diagonal of the correlations."""


@dataclass(frozen=True)
class SparseFactor:
    """G, sparse and lower triangular, with G A G^T near the identity for a symmetric positive A (H, H).

    Each row of G solves a small dense system with its nearest earlier neighbours (Vecchia 1988; Kaporin
    1994), so building and applying it is linear in H, unlike a Cholesky factor of A.
    lower: G; upper: its transpose; scale: (H, C), each class's G being `lower` times diag(scale[:, c]), or
    (H, 1) for all classes, or None: all ones. rank: (H,) the order that "earlier" means, where it is known.
    """

    lower: SparseRows
    upper: SparseRows
    scale: torch.Tensor | None = None
    rank: np.ndarray | None = None

    def pull(self, gradient: torch.Tensor) -> torch.Tensor:
        """G g: gradient by the weights (H, C) to gradient by the new coordinates (H, C)."""
        return self.lower.times(gradient if self.scale is None else gradient * self.scale)

    def push(self, step: torch.Tensor) -> torch.Tensor:
        """G^T u: a step in the new coordinates (H, C) to a step in the weights (H, C)."""
        pushed = self.upper.times(step)
        return pushed if self.scale is None else pushed.mul_(self.scale)

    def scaled(self, diagonal: torch.Tensor) -> SparseFactor:
        """Of the factor for correlations: that for the Gram matrix which has this diagonal, (H,), or each
        class's (H, C)."""
        return replace(self, scale=diagonal.reshape(len(diagonal), -1).rsqrt())


def sparse_factor(
    hinges: np.ndarray,
    gamma: np.ndarray,
    nodes: HingeNodes | None = None,
    device: torch.device | None = None,
) -> SparseFactor:
    """Factor for the correlations of Gaussian features, from closed forms; `scaled` makes one for a Gram
    matrix of it.

    Two features correlate as their L2 inner product: exact for samples of even density, close enough to
    guide a fit for others, positive definite always, and no sum over samples is needed.
    hinges: (H, d); gamma: (H,); nodes: the same on their lattices, where neighbours are found sooner.
    """
    count = len(hinges)
    rank = np.random.default_rng(0).permutation(count)  # a random order spreads the error evenly
    near = _by_tree(hinges) if nodes is None else None

    def rows_of(part: slice) -> tuple[np.ndarray, np.ndarray]:
        rows = np.arange(part.start, part.stop)
        found = nearest_earlier(rows, hinges, rank, nodes, NEIGHBOURS) if near is None else near(part)
        return factor_rows(rows, found, rank, hinges, gamma)

    with Threads(device) as threads:
        parts = zip(*threads.map(rows_of, threads.split(count)))
    columns, values = (torch.from_numpy(np.concatenate(part)) for part in parts)
    offsets = torch.arange(0, len(columns), NEIGHBOURS + 1, dtype=torch.int32)
    lower = SparseRows(*(part.to(device or "cpu") for part in (offsets, columns, values)))
    return SparseFactor(lower, lower.transposed(count), rank=rank)


def extended_factor(
    before: SparseFactor,
    rank: np.ndarray,
    places: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
    nodes: HingeNodes,
) -> SparseFactor:
    """Factor for the correlations of Gaussian features, most of which had one: new ones come last in the
    order, so that rows whose neighbours are all still there stay.

    rank: (E,) that of the E earlier ones; places: (E,) which of hinges (H, d) they are now, -1 for none.
    """
    width, count = NEIGHBOURS + 1, len(hinges)
    columns, values = np.zeros((count, width), np.int32), np.zeros((count, width), np.float32)
    stay = np.flatnonzero(places >= 0)
    now, held = places[stay], before.lower.values.numpy().reshape(-1, width)[stay]
    coupled = places[before.lower.columns.numpy().reshape(-1, width)[stay]]
    coupled[held == 0] = 0
    columns[now], values[now] = coupled, held
    ranks, anew = np.full(count, -1, np.int64), np.ones(count, bool)
    ranks[now], anew[now] = rank[stay], (coupled < 0).any(1)
    fresh = np.flatnonzero(ranks < 0)
    ranks[fresh] = rank.max(initial=-1) + 1 + np.random.default_rng(0).permutation(len(fresh))
    rows = np.flatnonzero(anew)
    found = factor_rows(rows, nearest_earlier(rows, hinges, ranks, nodes, NEIGHBOURS), ranks, hinges, gamma)
    columns[rows], values[rows] = (part.reshape(-1, width) for part in found)
    offsets = torch.arange(0, count * width, width, dtype=torch.int32)
    lower = SparseRows(offsets, torch.from_numpy(columns.reshape(-1)), torch.from_numpy(values.reshape(-1)))
    return SparseFactor(lower, lower.transposed(count), rank=ranks)


def _by_tree(hinges: np.ndarray) -> Callable[[slice], np.ndarray]:
    """A function that gives the hinge points (n, .) nearest to each of some rows of hinges (H, d)."""
    from scipy.spatial import cKDTree  # here, to keep the import of the map light

    candidates = min(5 * NEIGHBOURS // 2, len(hinges))
    tree = cKDTree(hinges)
    return lambda part: np.asarray(tree.query(hinges[part], candidates)[1].reshape(-1, candidates), np.int32)


@compiled
def factor_rows(
    rows: np.ndarray, near: np.ndarray, rank: np.ndarray, places: np.ndarray, gamma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (n,) of the factor for correlations, each of NEIGHBOURS + 1 entries: columns and values, (n * .,).

    near: (n, .) hinge points near each row's own, nearest first; rank: (H,) which ones are earlier; places:
    (H, d); gamma: (H,). A row couples its nearest earlier neighbours and, last, itself; 0 pads.
    """
    width = NEIGHBOURS + 1
    columns = np.zeros((len(near), width), np.int32)
    values = np.zeros((len(near), width), np.float32)
    factor, column = np.empty((width, width)), np.empty(width)
    for row in range(len(near)):
        own, count = rows[row], 0
        for other in near[row]:
            if rank[other] < rank[own] and count < NEIGHBOURS:
                columns[row, count] = other
                count += 1
        columns[row, NEIGHBOURS] = own
        for a in range(count + 1):
            p = columns[row, a] if a < count else own
            for b in range(a + 1):
                q = columns[row, b] if b < count else own
                squared = 0.0
                for axis in range(places.shape[1]):
                    squared += (np.float64(places[p, axis]) - places[q, axis]) ** 2
                total, product = np.float64(gamma[p]) + gamma[q], np.float64(gamma[p]) * gamma[q]
                overlap = 1.0
                if gamma[p] != gamma[q]:
                    overlap = (2 * np.sqrt(product) / total) ** (0.5 * places.shape[1])
                # The ridge keeps hinge points that coincide apart.
                sums = overlap * np.exp(-product / total * squared) + (RIDGE if a == b else 0.0)
                for c in range(b):
                    sums -= factor[a, c] * factor[b, c]
                factor[a, b] = np.sqrt(sums) if a == b else sums / factor[b, b]
        # Last column of the local inverse, scaled to a unit diagonal of G A G^T.
        for a in range(count, -1, -1):
            sums = 1 / factor[count, count] if a == count else 0.0
            for b in range(a + 1, count + 1):
                sums -= factor[b, a] * column[b]
            column[a] = sums / factor[a, a]
        for a in range(count):
            values[row, a] = column[a] / np.sqrt(column[count])
        values[row, NEIGHBOURS] = np.sqrt(column[count])
    return columns.reshape(-1), values.reshape(-1)
