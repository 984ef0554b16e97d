"""Coordinates in which overlapping kernels look independent: a sparse approximate Cholesky factor.

Knows hinge points and widths; knows nothing of samples' classes or losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.compiled import compiled
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
    None: all ones.
    """

    lower: SparseRows
    upper: SparseRows
    scale: torch.Tensor | None = None

    def pull(self, gradient: torch.Tensor) -> torch.Tensor:
        """G g: gradient by the weights (H, C) to gradient by the new coordinates (H, C)."""
        return self.lower.times(gradient if self.scale is None else gradient * self.scale)

    def push(self, step: torch.Tensor) -> torch.Tensor:
        """G^T u: a step in the new coordinates (H, C) to a step in the weights (H, C)."""
        pushed = self.upper.times(step)
        return pushed if self.scale is None else pushed.mul_(self.scale)


def sparse_factor(diagonal: torch.Tensor, hinges: np.ndarray, gamma: np.ndarray) -> SparseFactor:
    """Factor for the Gram matrix of Gaussian features, from its diagonal, (H,) or each class's (H, C), and
    closed forms.

    Two features correlate as their L2 inner product: exact for samples of even density, close enough to
    guide a fit for others, positive definite always, and no sum over samples is needed.
    hinges: (H, d); gamma: (H,).
    """
    from scipy.spatial import cKDTree  # here, to keep the import of the map light

    count = len(hinges)
    rank = np.random.default_rng(0).permutation(count)  # a random order spreads the error evenly
    candidates = min(5 * NEIGHBOURS // 2, count)
    tree = cKDTree(hinges)

    def rows_of(part: slice) -> tuple[np.ndarray, np.ndarray]:
        near = tree.query(hinges[part], candidates)[1].reshape(-1, candidates)
        return factor_rows(part.start, near, rank, hinges, gamma)

    with Threads(diagonal.device) as threads:
        parts = zip(*threads.map(rows_of, threads.split(count)))
    columns, values = (torch.from_numpy(np.concatenate(part)).to(diagonal.device) for part in parts)
    scale = diagonal.rsqrt() if diagonal.ndim == 2 else None
    if scale is None:
        values *= diagonal.rsqrt()[columns.long()]
    width = NEIGHBOURS + 1
    offsets = torch.arange(0, len(columns), width, dtype=torch.int32, device=diagonal.device)
    lower = SparseRows(offsets, columns, values)
    return SparseFactor(lower, lower.transposed(count), scale)


@compiled
def factor_rows(
    first: int, near: np.ndarray, rank: np.ndarray, places: np.ndarray, gamma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows first.. of the factor for correlations, n of NEIGHBOURS + 1 entries: columns and values, (n * .,).

    near: (n, .) hinge points near each row's own, nearest first; rank: (H,) which ones are earlier; places:
    (H, d); gamma: (H,). A row couples its nearest earlier neighbours and, last, itself; 0 pads.
    """
    width = NEIGHBOURS + 1
    columns = np.zeros((len(near), width), np.int32)
    values = np.zeros((len(near), width), np.float32)
    factor, column = np.empty((width, width)), np.empty(width)
    for row in range(len(near)):
        own, count = first + row, 0
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
