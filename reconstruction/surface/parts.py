"""Separate parts of an object, which of them stay in its mesh, and voids. Knows lattices and points only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.disjoint_sets import join

SEEN_POINTS = 15
"""A part with this many seen points in its cells, and this share of them all, is no stray measurement: it
stays however small it is."""
SEEN_SHARE = 0.02
"""Real masks bleed: what holds less of an object's seen points, away from the rest, is mostly not its own."""


class Parts(NamedTuple):
    """The parts of an object on a lattice (nx, ny, nz).

    A row of nodes falls into runs of one sign: first_of_row (nx ny + 1,) says which are a row's, ends (R,)
    where along the row each ends, numbers (R,) of which part it is, 0 outside; parts are numbered in the
    order of their first nodes. sizes: (count + 1,) nodes of each part, that of the outside as 0.
    """

    first_of_row: np.ndarray
    ends: np.ndarray
    numbers: np.ndarray
    sizes: np.ndarray


def label(log_odds: np.ndarray) -> Parts:
    """Parts of an object, nodes of (nx, ny, nz) with log odds above 0 that hang together by faces.

    Enclosed hollows are turned to the inside first: what nothing can ever see is no feature. The border of
    the lattice must be outside.
    """
    width = log_odds.shape[1]
    first_of_row, ends, signs = _runs(log_odds)
    numbers, sizes, inside = _pieces(width, first_of_row, ends, signs)
    if np.count_nonzero(~inside) > 1:  # beside the outside proper, which holds the first node
        void = ~inside
        void[0] = False
        _turn(log_odds, first_of_row, ends, void[numbers])
        first_of_row, ends, signs = _runs(log_odds)
        numbers, sizes, _ = _pieces(width, first_of_row, ends, signs)
    return Parts(first_of_row, ends, numbers, np.append(0, sizes[1:]))


def drop(log_odds: np.ndarray, parts: Parts, kept: np.ndarray) -> None:
    """Turn the nodes of all parts of a lattice (nx, ny, nz) but those kept, by number, to the outside."""
    dropped = np.ones(len(parts.sizes), bool)
    dropped[kept] = dropped[0] = False
    _turn(log_odds, parts.first_of_row, parts.ends, dropped[parts.numbers])


@compiled
def _turn(values: np.ndarray, first_of_row: np.ndarray, ends: np.ndarray, turned: np.ndarray) -> None:
    """Turn runs, turned (R,) of them, from the inside to the outside or the other way round."""
    ny = values.shape[1]
    for row in range(len(first_of_row) - 1):
        line, start = values[row // ny, row % ny], 0
        for run in range(first_of_row[row], first_of_row[row + 1]):
            if turned[run]:
                for k in range(start, ends[run]):
                    line[k] = np.float32(-0.01) if line[k] > 0 else max(-line[k], np.float32(0.01))
            start = ends[run]


@compiled
def _runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The rows of a lattice (nx, ny, nz) as runs: see Parts; and whether a run is above 0 (R,)."""
    nx, ny, nz = values.shape
    first_of_row = np.zeros(nx * ny + 1, np.int64)
    ends = np.empty(values.size, np.int32)
    signs = np.empty(values.size, np.bool_)
    count = 0
    for row in range(nx * ny):
        line = values[row // ny, row % ny]
        sign = line[0] > 0
        for k in range(1, nz):
            if (line[k] > 0) != sign:
                ends[count], signs[count] = k, sign
                count += 1
                sign = not sign
        ends[count], signs[count] = nz, sign
        count += 1
        first_of_row[row + 1] = count
    return first_of_row, ends[:count].copy(), signs[:count].copy()


@compiled
def _pieces(
    width: int, first_of_row: np.ndarray, ends: np.ndarray, signs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which runs hang together by faces: each one's piece (R,), numbered in the order of their first nodes,
    the pieces' sizes, and whether they are above 0. width: rows a plane."""
    parent = np.arange(len(ends))  # an earlier run of the same piece; the first one's is itself
    for row in range(len(first_of_row) - 1):
        if row % width:
            _join_rows(row - 1, row, first_of_row, ends, signs, parent)
        if row >= width:
            _join_rows(row - width, row, first_of_row, ends, signs, parent)
    # Roots are first runs: each comes before the runs that point at it.
    sizes, above, found = np.zeros(len(ends), np.int64), np.empty(len(ends), np.bool_), 0
    for row in range(len(first_of_row) - 1):
        start = 0
        for run in range(first_of_row[row], first_of_row[row + 1]):
            if parent[run] == run:
                parent[run], above[found] = found, signs[run]
                found += 1
            else:
                parent[run] = parent[parent[run]]
            sizes[parent[run]] += ends[run] - start
            start = ends[run]
    return parent, sizes[:found].copy(), above[:found].copy()


@compiled
def _join_rows(
    earlier: int,
    row: int,
    first_of_row: np.ndarray,
    ends: np.ndarray,
    signs: np.ndarray,
    parent: np.ndarray,
) -> None:
    """The runs of a row with those of an earlier row that they touch."""
    one, other = first_of_row[row], first_of_row[earlier]
    while one < first_of_row[row + 1]:
        if signs[one] == signs[other]:
            join(parent, one, other)
        ended = ends[one] <= ends[other]
        other += ends[other] <= ends[one]
        one += ended


def parts_to_keep(
    parts: Parts, shape: tuple[int, ...], smallest: float, cells: np.ndarray | None
) -> np.ndarray:
    """Numbers of the parts of a lattice of some shape that are large enough or were seen.

    smallest: share of the largest part's nodes; cells: (N, 3) the lattice cells of seen points, None when
    nothing is known of them.
    """
    keep = parts.sizes >= smallest * parts.sizes.max()
    keep[0] = False
    if cells is not None and not keep[1:].all():
        least = max(SEEN_POINTS, SEEN_SHARE * len(cells))
        keep |= (_points_in(*parts, *shape, cells) >= least) & (parts.sizes > 0)
    return np.flatnonzero(keep)


@compiled
def _points_in(
    first_of_row: np.ndarray,
    ends: np.ndarray,
    numbers: np.ndarray,
    sizes: np.ndarray,
    nx: int,
    ny: int,
    nz: int,
    cells: np.ndarray,
) -> np.ndarray:
    """How many points lie in cells (N, 3) with a node of each part (count + 1,), the last one of a cell's."""
    points = np.zeros(len(sizes), np.int64)
    for n in range(len(cells)):
        i, j, k = cells[n, 0], cells[n, 1], cells[n, 2]
        if 0 <= i < nx - 1 and 0 <= j < ny - 1 and 0 <= k < nz - 1:
            part = 0
            for row in (i * ny + j, i * ny + j + 1, (i + 1) * ny + j, (i + 1) * ny + j + 1):
                run = first_of_row[row]
                while ends[run] <= k:
                    run += 1
                part = max(part, numbers[run], numbers[run + (ends[run] == k + 1)])
            points[part] += 1
    return points
