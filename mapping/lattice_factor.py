"""Coordinates in which the kernels of hashed hinge points look independent; shapes are not coupled.

Knows hinge points; knows nothing of samples, classes or losses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.compiled import compiled
from mapping.hashed_hinges import HashedHinges, hinge_at
from mapping.preconditioner import NEIGHBOURS, SparseFactor, factor_rows
from mapping.sparse_rows import SparseRows
from mapping.threads import Threads

FARTHEST = 2
"""Neighbours are looked for up to so many spacings away: farther ones hardly correlate."""


@dataclass(frozen=True)
class LatticeFactor:
    """The factor of the kernels' correlations, as in `preconditioner`: made once for hinge points, then
    scaled for any Gram matrix of theirs. lower: its rows; upper: their transpose."""

    lower: SparseRows
    upper: SparseRows

    @classmethod
    def of(cls, hinges: HashedHinges) -> LatticeFactor:
        """Of hinge points, as if samples lay evenly."""
        count = len(hinges.nodes)
        rank = np.random.default_rng(0).permutation(count)  # a random order spreads the error evenly
        places, width = hinges.nodes.astype(np.float32), np.full(count, hinges.width, np.float32)
        steps = np.stack(np.meshgrid(*[np.arange(-FARTHEST, FARTHEST + 1)] * 3, indexing="ij"), -1)
        steps = steps.reshape(-1, 3)
        squared = (steps**2).sum(axis=1)
        nearest = np.argsort(squared, kind="stable")
        steps = steps[nearest[(squared[nearest] > 0) & (squared[nearest] <= FARTHEST**2)]]

        def rows_of(part: slice) -> tuple[np.ndarray, np.ndarray]:
            near = _earlier(part.start, part.stop, hinges, rank, steps)
            return factor_rows(np.arange(part.start, part.stop), near, rank, places, width)

        with Threads() as threads:
            columns, values = zip(*threads.map(rows_of, threads.split(count)))
        offsets = torch.arange(0, count * (NEIGHBOURS + 1), NEIGHBOURS + 1, dtype=torch.int32)
        lower = SparseRows(offsets, *(torch.from_numpy(np.concatenate(part)) for part in (columns, values)))
        return cls(lower, lower.transposed(count))

    def scaled(self, diagonal: torch.Tensor) -> SparseFactor:
        """The factor for the Gram matrix that has this diagonal (H,), or each class's (H, C)."""
        return SparseFactor(self.lower, self.upper, diagonal.reshape(len(diagonal), -1).rsqrt())


@compiled
def _earlier(first: int, last: int, hinges: HashedHinges, rank: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """(n, NEIGHBOURS) nearest hinge points of the same shape and an earlier rank, of first..last; rows with
    fewer have their own point in their stead."""
    near, t = np.empty((last - first, NEIGHBOURS), np.int64), 0
    for own in range(first, last):
        while own >= hinges.first[t + 1]:
            t += 1
        x, y, z = (
            np.int64(hinges.nodes[own, 0]),
            np.int64(hinges.nodes[own, 1]),
            np.int64(hinges.nodes[own, 2]),
        )
        count = 0
        near[own - first] = own
        for m in range(len(steps)):
            other = hinge_at(x + steps[m, 0], y + steps[m, 1], z + steps[m, 2], t, hinges)
            if other >= 0 and rank[other] < rank[own]:
                near[own - first, count] = other
                count += 1
                if count == NEIGHBOURS:
                    break
    return near
