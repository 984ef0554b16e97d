"""A cuboid anywhere in space. Knows points only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GRID = 7
"""Inner places along each side."""
MOST = 0.3
"""They are no farther than this share of a side from its ends."""


@dataclass(frozen=True)
class Cuboid:
    """axes: (3, 3) rows of unit length at right angles; low, high: (3,) its extent along them [m]."""

    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) lie in it (N,) float32 [m], negative outside."""
        at = points @ self.axes.T.astype(np.float32)
        beyond = np.maximum(self.low.astype(np.float32) - at, at - self.high.astype(np.float32))
        outside = np.sqrt((np.maximum(beyond, 0) ** 2).sum(1))
        return np.where(outside > 0, -outside, -beyond.max(1))

    def faces(self, spacing: float) -> np.ndarray:
        """Places (M, 3) float32 on its faces, no farther than `spacing` from each other along their sides
        [m]."""
        along = [np.linspace(a, b, 1 + int(np.ceil((b - a) / spacing))) for a, b in zip(self.low, self.high)]
        places: list[np.ndarray] = []
        for axis in range(3):
            ends = [*along[:axis], [self.low[axis], self.high[axis]], *along[axis + 1 :]]
            places.append(np.stack(np.meshgrid(*ends, indexing="ij"), -1).reshape(-1, 3))
        return (np.concatenate(places) @ self.axes).astype(np.float32)

    def inner(self, margin: float) -> np.ndarray:
        """Places (GRID^3, 3) float32 within it, `margin` [m] from its faces, less where it is thin."""
        sides = self.high - self.low
        inset = np.minimum(margin, MOST * sides)
        share = np.linspace(0, 1, GRID)
        shares = np.stack(np.meshgrid(share, share, share, indexing="ij"), -1).reshape(-1, 3)
        return ((self.low + inset + shares * (sides - 2 * inset)) @ self.axes).astype(np.float32)
