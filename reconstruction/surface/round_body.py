"""A body of revolution: an axis, and how deep places of the half plane beside it lie behind its surface.

Knows points and tables; knows nothing of images, maps or lattices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.compiled import compiled
from reconstruction.surface.profile_depth import CELL, UNKNOWN

_PER_CELL, _HALF = np.float32(1 / CELL), np.float32(0.5)


@dataclass(frozen=True)
class RoundBody:
    """turn: (3, 3) float32, rotates points so that the axis is upright; axis: (2,) where it then stands [m];
    height: of the table's first row [m]; table: (R, Z) float32, how far places at each radius and height,
    `CELL` apart, lie behind the surface [m], negative where it is empty, UNKNOWN or so where nothing is
    known."""

    turn: np.ndarray
    axis: np.ndarray
    height: float
    table: np.ndarray

    def depth(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) [m] lie in the body (N,) float32 [m], as in the table."""
        points = np.ascontiguousarray(points, np.float32)
        axis = np.asarray(self.axis, np.float32)
        return _in_table(points, self.turn, axis, np.float32(self.height), self.table)


@compiled
def _in_table(
    points: np.ndarray, turn: np.ndarray, axis: np.ndarray, height: float, table: np.ndarray
) -> np.ndarray:
    """The table (R, Z) of `RoundBody` between its cells at points (N, 3), beyond it UNKNOWN; float32."""
    rows, columns = table.shape
    found = np.empty(len(points), np.float32)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        across = turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z - axis[0]
        aside = turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z - axis[1]
        up = (turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z - height) * _PER_CELL
        out = np.sqrt(across * across + aside * aside) * _PER_CELL
        if up < 0 or out > rows - 1 or up > columns - 1:
            found[i] = UNKNOWN
            continue
        r, c = min(int(out), rows - 2), min(int(up), columns - 2)
        dr, dc = out - np.float32(r), up - np.float32(c)
        total = sums = np.float32(0)
        for j in range(2):
            for k in range(2):
                weight = (dr if j else 1 - dr) * (dc if k else 1 - dc)
                if table[r + j, c + k] < UNKNOWN:
                    total += weight
                    sums += weight * table[r + j, c + k]
        # Between what is known and what is not, nothing is between their numbers.
        found[i] = sums / total if total > _HALF else UNKNOWN
    return found
