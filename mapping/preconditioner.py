"""Coordinates in which overlapping kernels look independent: a sparse approximate Cholesky factor.

Knows hinge points and widths; knows nothing of samples' classes or losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

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
    lower: G; upper: its transpose.
    """

    lower: SparseRows
    upper: SparseRows

    def pull(self, gradient: torch.Tensor) -> torch.Tensor:
        """G g: gradient by the weights (H, C) to gradient by the new coordinates (H, C)."""
        return self.lower.times(gradient)

    def push(self, step: torch.Tensor) -> torch.Tensor:
        """G^T u: a step in the new coordinates (H, C) to a step in the weights (H, C)."""
        return self.upper.times(step)


def sparse_factor(diagonal: torch.Tensor, hinges: np.ndarray, gamma: np.ndarray) -> SparseFactor:
    """Factor for the Gram matrix of Gaussian features, from its diagonal (H,) and closed forms.

    Two features correlate as their L2 inner product: exact for samples of even density, close enough to
    guide a fit for others, positive definite always, and no sum over samples is needed.
    hinges: (H, d); gamma: (H,).
    """
    from scipy.spatial import cKDTree  # here, to keep the import of the map light

    count = len(hinges)
    rank = np.random.default_rng(0).permutation(count)  # a random order spreads the error evenly
    candidates = min(5 * NEIGHBOURS // 2, count)
    tree = cKDTree(hinges)
    places, width = (torch.from_numpy(a).to(diagonal.device) for a in (hinges, gamma))

    def rows_of(part: slice) -> tuple[torch.Tensor, torch.Tensor]:
        near = tree.query(hinges[part], candidates)[1].reshape(-1, candidates)
        earlier = rank[near] < rank[part, None]
        # The nearest NEIGHBOURS earlier rows, the row itself last; -1 pads.
        order = np.argsort(~earlier, axis=1, kind="stable")[:, :NEIGHBOURS]
        chosen = np.where(np.take_along_axis(earlier, order, 1), np.take_along_axis(near, order, 1), -1)
        pattern = np.column_stack([chosen, np.arange(part.start, part.stop)])
        pattern_t = torch.from_numpy(pattern).to(diagonal.device)
        return pattern_t.clamp_min(0), _factor_rows(pattern_t, places, width)

    with Threads(diagonal.device) as threads:
        parts = zip(*threads.map(rows_of, threads.split(count)))
    index, values = (torch.cat(part) for part in parts)
    values = values * diagonal.rsqrt()[index]
    offsets = torch.arange(0, index.numel(), index.shape[1], dtype=torch.int32, device=diagonal.device)
    lower = SparseRows(offsets, index.reshape(-1).int(), values.reshape(-1))
    return SparseFactor(lower, lower.transposed(count))


def _factor_rows(pattern: torch.Tensor, places: torch.Tensor, gamma: torch.Tensor) -> torch.Tensor:
    """Rows (n, m) of the factor for correlations: each couples the hinge points of its pattern (n, m).

    pattern: hinge indices, the row's own last, -1 pads; places: (H, d); gamma: (H,).
    """
    valid = pattern >= 0
    places, width = places[pattern.clamp_min(0)], gamma[pattern.clamp_min(0)]  # (n, m, d), (n, m)
    total = width[:, :, None] + width[:, None, :]
    product = width[:, :, None] * width[:, None, :]
    # Axis by axis: sums over a last dimension of three are several times as slow.
    squared = torch.zeros_like(total)
    for along in places.unbind(2):
        squared += (along[:, :, None] - along[:, None, :]).square_()
    local = (2 * product.sqrt() / total).sqrt() ** places.shape[2] * torch.exp(-product / total * squared)
    local = local * (valid[:, :, None] & valid[:, None, :])
    # Padding becomes the identity; the ridge keeps hinge points that coincide apart.
    local.diagonal(dim1=1, dim2=2).add_((~valid).to(local.dtype) + RIDGE)
    factor = torch.linalg.cholesky(local)
    unit = torch.zeros(*pattern.shape, 1, device=places.device)
    unit[:, -1, 0] = 1 / factor[:, -1, -1]
    # Last column of the local inverse, scaled to a unit diagonal of G A G^T. Triangular solves only:
    # batched LU is wrong in torch 2.13 with two threads.
    column = torch.linalg.solve_triangular(factor.mT, unit, upper=True)[..., 0]
    return column / column[:, -1:].sqrt() * valid
