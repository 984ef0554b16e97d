"""A cuboid anywhere in space. Knows points only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

GRID = 7
"""Inner places along each side."""
MOST = 0.3
"""They are no farther than this share of a side from its ends."""


@dataclass(frozen=True)
class Cuboid:
    """axes: (3, 3) rows of unit length at right angles; low, high: (3,) its extent along them [m]; open:
    (2, 3) bool, at which of these ends it may go on."""

    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    open: np.ndarray = field(default_factory=lambda: np.zeros((2, 3), bool))

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) lie in it (N,) float32 [m], negative outside, NaN where it may go on."""
        at = points @ self.axes.T.astype(np.float32)
        beyond = np.stack([self.low.astype(np.float32) - at, at - self.high.astype(np.float32)])  # (2, N, 3)
        further = (self.open[:, None] & (beyond > 0)).any((0, 2))
        closed = np.where(self.open[:, None], np.float32(-np.inf), beyond).max(0)
        outside = np.sqrt((np.maximum(closed, 0) ** 2).sum(1))
        depth = np.where(outside > 0, -outside, -closed.max(1))
        depth[further & (outside == 0)] = np.nan
        return depth

    def faces(self, spacing: float) -> np.ndarray:
        """Places (M, 3) float32 on its known faces, no farther than `spacing` from each other along them
        [m]."""
        along = [np.linspace(a, b, 1 + int(np.ceil((b - a) / spacing))) for a, b in zip(self.low, self.high)]
        places: list[np.ndarray] = []
        for axis in range(3):
            closed = [end for end, open in zip((self.low, self.high), self.open[:, axis]) if not open]
            ends = [*along[:axis], [end[axis] for end in closed], *along[axis + 1 :]]
            places.append(np.stack(np.meshgrid(*ends, indexing="ij"), -1).reshape(-1, 3))
        return (np.concatenate(places) @ self.axes).astype(np.float32)

    def inner(self, margin: float) -> np.ndarray:
        """Places (GRID^3, 3) float32 within it, `margin` [m] from its faces, less where it is thin."""
        sides = self.high - self.low
        inset = np.minimum(margin, MOST * sides)
        share = np.linspace(0, 1, GRID)
        shares = np.stack(np.meshgrid(share, share, share, indexing="ij"), -1).reshape(-1, 3)
        return ((self.low + inset + shares * (sides - 2 * inset)) @ self.axes).astype(np.float32)
