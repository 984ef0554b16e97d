"""Hinge points as nodes of lattices, one lattice a width: who is where, and who is near whom.

Knows hinge points and widths; knows nothing of samples, classes or weights.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.hinge_cells import LARGEST_TABLE, MOST_WIDTHS, lattice_of
from mapping.kernels import reach


class HingeNodes(NamedTuple):
    """Hinge points of T widths as nodes of lattices, in three dimensions, of which some may have one node.

    ids: index of the hinge point at each node of the lattices, one lattice after the other, or -1; first:
    (T,) where each lattice begins; shape, low, spacing: (T, 3) its nodes a side, first node and distances;
    gamma: (T,).
    """

    ids: np.ndarray
    first: np.ndarray
    shape: np.ndarray
    low: np.ndarray
    spacing: np.ndarray
    gamma: np.ndarray

    @classmethod
    def of(cls, hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> HingeNodes | None:
        """Of hinge points (H, d) of widths gamma (H,); None where they lie on no lattices. cutoff: smaller
        features do not count."""
        widths, d = np.unique(gamma), hinges.shape[1]
        if d > 3 or len(widths) > MOST_WIDTHS:
            return None
        ids, shape, low, spacing = [], [], [], []
        for width in widths:
            rows = np.flatnonzero(gamma == width)
            found = lattice_of(hinges[rows], float(reach(float(width), cutoff)))
            if found is None:
                return None
            sides = tuple(int(n) for n in found[2].max(0) + 1)
            if np.prod(sides, dtype=float) > LARGEST_TABLE:
                return None
            table = np.full(int(np.prod(sides)), -1, np.int32)
            table[np.ravel_multi_index(tuple(found[2].T), sides)] = rows
            if np.count_nonzero(table >= 0) < len(rows):
                return None  # several in one place
            flat = 3 - d
            ids.append(table)
            shape.append((*sides, *[1] * flat))
            low.append((*found[0], *[0] * flat))
            spacing.append((*found[1], *[1] * flat))
        first = np.append(0, np.cumsum([len(table) for table in ids]))[:-1]
        lows, sides_of = np.array(low, np.float32), np.array(spacing, np.float32)
        return cls(np.concatenate(ids), first, np.array(shape), lows, sides_of, widths.astype(np.float32))


@compiled
def nearest_earlier(
    rows: np.ndarray, hinges: np.ndarray, rank: np.ndarray, nodes: HingeNodes, count: int
) -> np.ndarray:
    """(n, count) hinge points near each of rows (n,) that have an earlier rank (H,), nearest first, looked
    for at the node nearest to it and beside that on every lattice; rows with fewer have their own point in
    their stead. hinges: (H, d)."""
    ids, first, shape, low, spacing, _ = nodes
    found = np.empty((len(rows), count), np.int32)
    least = np.empty(count, np.float32)
    begin, end = np.zeros(3, np.int64), np.zeros(3, np.int64)
    squares = np.zeros((3, 3), np.float32)
    for n_row in range(len(rows)):
        own, row = rows[n_row], found[n_row]
        row[:] = own
        least[:] = np.inf
        for t in range(len(first)):
            for axis in range(3):
                place = hinges[own, axis] if axis < hinges.shape[1] else np.float32(0)
                node = int(np.rint((place - low[t, axis]) / spacing[t, axis]))
                begin[axis] = max(node - 1, 0)
                end[axis] = min(node + 2, int(shape[t, axis]))
                for n in range(begin[axis], end[axis]):
                    off = place - (low[t, axis] + np.float32(n) * spacing[t, axis])
                    squares[axis, n - begin[axis]] = off * off
            for i in range(begin[0], end[0]):
                for j in range(begin[1], end[1]):
                    of_plane = squares[0, i - begin[0]] + squares[1, j - begin[1]]
                    if of_plane >= least[count - 1]:
                        continue
                    at = first[t] + (i * shape[t, 1] + j) * shape[t, 2]
                    for k in range(begin[2], end[2]):
                        other = ids[at + k]
                        squared = of_plane + squares[2, k - begin[2]]
                        if other < 0 or rank[other] >= rank[own] or squared >= least[count - 1]:
                            continue
                        place_in = count - 1
                        while place_in > 0 and least[place_in - 1] > squared:
                            least[place_in], row[place_in] = least[place_in - 1], row[place_in - 1]
                            place_in -= 1
                        least[place_in], row[place_in] = squared, other
    return found
