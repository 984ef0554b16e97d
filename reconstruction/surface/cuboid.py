"""A cuboid anywhere in space. Knows points only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mapping.compiled import compiled

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
        axes, low, high = (np.asarray(part, np.float32) for part in (self.axes, self.low, self.high))
        return _depth(np.ascontiguousarray(points, np.float32), axes, low, high, self.open)

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


@compiled
def _depth(
    points: np.ndarray, axes: np.ndarray, low: np.ndarray, high: np.ndarray, open: np.ndarray
) -> np.ndarray:
    """As `Cuboid.depth`; all but open in float32."""
    depth = np.empty(len(points), np.float32)
    for i in range(len(points)):
        squares, inside, further = np.float32(0), np.float32(np.inf), False
        for axis in range(3):
            at = np.float32(0)
            for part in range(3):
                at += points[i, part] * axes[axis, part]
            for side in range(2):
                within = at - low[axis] if side == 0 else high[axis] - at
                if open[side, axis]:
                    further |= within < 0
                else:
                    squares += min(within, np.float32(0)) ** 2
                    inside = min(inside, within)
        if squares > 0:
            depth[i] = -np.sqrt(squares)
        else:
            depth[i] = np.nan if further else inside
    return depth
