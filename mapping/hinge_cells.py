"""Which hinge points are in a point's reach, by arithmetic instead of search, where they lie on lattices.

Knows hinge points and widths; knows nothing of classes or weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.kernels import reach

LARGEST_TABLE = 2**22
"""Cells of a table; with hinge points further apart than this covers, a search is cheaper."""
MOST_CANDIDATES = 4096
"""Nodes of the box around a point's reach. With more, rounding alone makes scattered points look like a
lattice."""
MOST_WIDTHS = 8
"""Each width has a table of its own."""
UNEVEN = 1e-2
"""Coordinates this close to a multiple of a lattice's spacing, in spacings, lie on it."""


@dataclass(frozen=True)
class HingeCells:
    """Hinge points of one width on a lattice, and a table that has a cell for each of its nodes.

    The hinge points in reach of a point lie at its nearest node or at one of M offsets from there.
    low: (d,) the first node; spacing: (d,); shape: (d,) nodes a side, with a rim as wide as the offsets;
    ids: (cells,) int32 index of the hinge point there or -1; steps: (M,) int32 from a cell to its candidates;
    quadratic: (d + 2, M), which turns a point's terms (see `locate`) into -gamma ||x - h||^2 of each;
    reached: (cells,) whether a hinge point is among a cell's candidates.
    """

    low: np.ndarray
    spacing: np.ndarray
    shape: tuple[int, ...]
    ids: np.ndarray
    steps: np.ndarray
    quadratic: np.ndarray
    reached: np.ndarray

    def locate(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For points (N, d): the cell (N,) of the nearest node, -1 where no hinge point is in reach, and the
        terms (N, d + 2): offset from that node, its square, and 1."""
        d = X.shape[1]
        terms = np.ones((len(X), d + 2), np.float32)
        cell = np.zeros(len(X), np.int32)
        inside = np.ones(len(X), bool)
        for i, size in enumerate(self.shape):
            along = X[:, i] - np.float32(self.low[i])
            node = np.rint(along / np.float32(self.spacing[i]))
            terms[:, i] = along - node * np.float32(self.spacing[i])
            inside &= (node >= 0) & (node < size)
            cell = cell * np.int32(size) + np.clip(node, 0, size - 1).astype(np.int32)
        np.einsum("nd,nd->n", terms[:, :d], terms[:, :d], out=terms[:, d])
        return np.where(inside & self.reached[cell], cell, -1), terms


class Tables(NamedTuple):
    """Tables of several widths in one. ids, steps, quadratic: those of `HingeCells`, one after the other;
    starts: (T + 1,) where the steps of each begin; smallest: least exponent that is in reach."""

    ids: np.ndarray
    steps: np.ndarray
    quadratic: np.ndarray
    starts: np.ndarray
    smallest: np.float32

    @classmethod
    def of(cls, cells: Sequence[HingeCells], cutoff: float) -> Tables:
        ids, steps, quadratic = (
            np.concatenate([getattr(table, name) for table in cells], axis=-1)
            for name in ("ids", "steps", "quadratic")
        )
        starts = np.append(0, np.cumsum([len(table.steps) for table in cells]))
        return cls(ids, steps, quadratic, starts, np.float32(np.log(cutoff)))


@compiled
def pairs_in_reach(
    cell: np.ndarray, terms: np.ndarray, tables: Tables
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Hinge points in reach of points: how many each has (n,), and of all, point by point, the index and
    -gamma ||x - h||^2 (nnz,).

    cell: (n, T) int32 a point's cell in each table, counted from the first table's first one, -1 where
    nothing is in reach; terms: (n, T, d + 2) float32, both of `HingeCells.locate`.
    """
    ids, steps, quadratic, starts, smallest = tables
    most, widest = 1, 0  # one place more than there may be pairs: see below
    for t in range(cell.shape[1]):
        candidates = starts[t + 1] - starts[t]
        most += candidates * np.count_nonzero(cell[:, t] >= 0)
        widest = max(widest, candidates)
    lengths = np.zeros(len(cell), np.int64)
    columns, exponents = np.empty(most, np.int32), np.empty(most, np.float32)
    of_candidates = np.empty(widest, np.float32)
    found = 0
    for i in range(len(cell)):
        before = found
        for t in range(cell.shape[1]):
            if cell[i, t] < 0:
                continue
            first, count = starts[t], starts[t + 1] - starts[t]
            of_candidates[:count] = 0
            for j in range(terms.shape[2]):
                term = terms[i, t, j]
                of_hinges = quadratic[j, first : starts[t + 1]]
                for m in range(count):
                    of_candidates[m] += term * of_hinges[m]
            for m in range(count):
                # Written in any case, and written over unless it counts: a branch costs more.
                hinge = ids[cell[i, t] + steps[first + m]]
                columns[found], exponents[found] = hinge, of_candidates[m]
                found += (hinge >= 0) & (of_candidates[m] > smallest)
        lengths[i] = found - before
    return lengths, columns[:found].copy(), exponents[:found].copy()


def hinge_cells(hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> list[HingeCells] | None:
    """Tables of hinge points (H, d), one a width in gamma (H,); None where they lie on no lattices.

    cutoff: smaller features are out of reach.
    """
    widths = np.unique(gamma)
    if len(widths) > MOST_WIDTHS:
        return None
    found = []
    for width in widths:
        cells = _cells_of_width(hinges, np.flatnonzero(gamma == width), float(width), cutoff)
        if cells is None:
            return None
        found.append(cells)
    return found


def lattice_of(places: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The lattice that places (n, d) lie on: its first node (d,), spacing (d,), and the node (n, d) of each,
    counted from the first; None where there is none of less than MOST_CANDIDATES nodes within `radius`."""
    low, sides, node = [], [], []
    for coordinates in places.T.astype(np.float64):
        levels = np.unique(coordinates)
        step = float(np.diff(levels).min()) if len(levels) > 1 else radius
        index = (coordinates - levels[0]) / step
        whole = np.rint(index)
        if np.abs(index - whole).max() > UNEVEN:
            return None
        low.append(levels[0])
        sides.append(step)
        node.append(whole.astype(np.int64))
    spacing = np.array(sides)
    if np.prod(2 * radius / spacing + 1) > MOST_CANDIDATES:
        return None
    return np.array(low), spacing, np.stack(node, 1)


def _cells_of_width(hinges: np.ndarray, rows: np.ndarray, gamma: float, cutoff: float) -> HingeCells | None:
    radius = float(reach(gamma, cutoff))
    found = lattice_of(hinges[rows], radius)
    if found is None:
        return None
    low, spacing, node = found
    offsets = _offsets_in_reach(spacing, radius)
    rim = offsets.max(0)
    # Two rims: candidates of a node in the first one lie in the second at most.
    index = node + 2 * rim
    shape = tuple(int(n) for n in index.max(0) + 1 + 2 * rim)
    if np.prod(shape, dtype=float) > LARGEST_TABLE:
        return None
    cell = np.ravel_multi_index(tuple(index.T), shape)
    ids = np.full(np.prod(shape), -1, np.int32)
    ids[cell] = rows
    if np.count_nonzero(ids >= 0) < len(rows):
        return None  # several in one place
    strides = np.array([np.prod(shape[i + 1 :], dtype=int) for i in range(len(shape))])
    steps = offsets @ strides
    reached = np.zeros(len(ids), bool)
    reached[cell[:, None] - steps] = True
    along = offsets * spacing
    quadratic = np.vstack([2 * gamma * along.T, np.full(len(along), -gamma), -gamma * (along**2).sum(1)])
    return HingeCells(
        low=low - 2 * rim * spacing,
        spacing=spacing,
        shape=shape,
        ids=ids,
        steps=steps.astype(np.int32),
        quadratic=quadratic.astype(np.float32),
        reached=reached,
    )


def _offsets_in_reach(spacing: np.ndarray, radius: float) -> np.ndarray:
    """Offsets (M, d) of nodes that can be within `radius` of a point whose nearest node is the one at 0."""
    rim = np.floor(radius / spacing + 0.5).astype(int)
    axes = [np.arange(-n, n + 1) for n in rim]
    offsets = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(rim))
    gap = np.maximum(np.abs(offsets) - 0.5, 0) * spacing
    return offsets[(gap**2).sum(1) <= radius**2]
