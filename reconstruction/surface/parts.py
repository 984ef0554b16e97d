"""Separate parts of an object, which of them stay in its mesh, and voids. Knows lattices and points only."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

SEEN_POINTS = 15
"""A part with this many seen points in its cells, and this share of them all, is no stray measurement: it
stays however small it is."""
SEEN_SHARE = 0.02
"""Real masks bleed: what holds less of an object's seen points, away from the rest, is mostly not its own."""


def label(log_odds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of an object, nodes of (nx, ny, nz) with log odds above 0 that hang together by faces.

    Enclosed hollows are turned to the inside first: what nothing can ever see is no feature. The border of
    the lattice must be outside. Returns each node's part (nx, ny, nz) int32, 0 outside, numbered in the order
    of their first nodes, and their sizes (count + 1,), that of the outside as 0.
    """
    pieces, sizes, inside = _pieces(log_odds)
    if np.count_nonzero(~inside) > 1:  # beside the outside proper, which holds the first node
        _fill(log_odds, pieces, inside)
        if np.count_nonzero(inside) > 1:
            pieces, sizes, inside = _pieces(log_odds)
        else:
            pieces, sizes = np.minimum(pieces, 1), np.append(sizes[0], sizes[1:].sum())
    return pieces, np.append(0, sizes[1:])


@compiled
def _fill(log_odds: np.ndarray, pieces: np.ndarray, inside: np.ndarray) -> None:
    """Turn the pieces that are neither inside nor the first one to the inside."""
    values, numbers = log_odds.reshape(-1), pieces.reshape(-1)
    for node in range(len(values)):
        if numbers[node] > 0 and not inside[numbers[node]]:
            values[node] = max(-values[node], np.float32(0.01))


@compiled
def _pieces(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """All pieces of a lattice (nx, ny, nz) whose nodes hang together by faces and have one sign: each node's
    piece, numbered in the order of their first nodes, the pieces' sizes, and whether they are above 0."""
    nx, ny, nz = values.shape
    # Rows fall into runs of one sign, the unit that is joined with others.
    first_of_row = np.zeros(nx * ny + 1, np.int64)
    ends = np.empty(values.size, np.int32)
    signs = np.empty(values.size, np.bool_)
    parent = np.empty(values.size, np.int32)  # an earlier run of the same piece; the first one's is itself
    count = 0
    for row in range(nx * ny):
        first_of_row[row] = start = count
        line = values[row // ny, row % ny]
        sign = line[0] > 0
        for k in range(1, nz):
            if (line[k] > 0) != sign:
                ends[count], signs[count], parent[count] = k, sign, count
                count += 1
                sign = not sign
        ends[count], signs[count], parent[count] = nz, sign, count
        count += 1
        if row % ny:
            _join(row - 1, start, count, first_of_row, ends, signs, parent)
        if row >= ny:
            _join(row - ny, start, count, first_of_row, ends, signs, parent)
    # Roots are first runs: each comes before the runs that point at it.
    pieces, sizes = np.empty(values.shape, np.int32), np.zeros(count, np.int64)
    above, found, run = np.empty(count, np.bool_), 0, 0
    for row in range(nx * ny):
        line, start = pieces[row // ny, row % ny], 0
        while start < nz:
            if parent[run] == run:
                number, above[found] = found, signs[run]
                found += 1
            else:
                number = parent[parent[run]]
            parent[run] = number
            for k in range(start, ends[run]):
                line[k] = number
            sizes[number] += ends[run] - start
            start = ends[run]
            run += 1
    return pieces, sizes[:found], above[:found]


@compiled
def _join(
    row: int,
    first: int,
    last: int,
    first_of_row: np.ndarray,
    ends: np.ndarray,
    signs: np.ndarray,
    parent: np.ndarray,
) -> None:
    """Runs first..last - 1, those of one row, with the runs of an earlier row that they touch."""
    one, other = first, first_of_row[row]
    while one < last:
        if signs[one] == signs[other]:
            a, b = _root(parent, one), _root(parent, other)
            parent[max(a, b)] = min(a, b)
        ended = ends[one] <= ends[other]
        other += ends[other] <= ends[one]
        one += ended


@compiled
def _root(parent: np.ndarray, run: int) -> int:
    """The first run of a run's piece; the ways there become shorter."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


def parts_to_keep(
    parts: np.ndarray, sizes: np.ndarray, smallest: float, cells: np.ndarray | None
) -> np.ndarray:
    """Numbers of the parts that are large enough or were seen.

    parts: (nx, ny, nz) the number of each node's part, 0 outside; sizes: (count + 1,) as of `label`;
    smallest: share of the largest part's nodes; cells: (N, 3) the lattice cells of seen points, None when
    nothing is known of them.
    """
    keep = sizes >= smallest * sizes.max()
    keep[0] = False
    if cells is not None and not keep[1:].all():
        least = max(SEEN_POINTS, SEEN_SHARE * len(cells))
        keep |= (_points_in(parts, cells, len(sizes)) >= least) & (sizes > 0)
    return np.flatnonzero(keep)


def drop(values: np.ndarray, parts: np.ndarray, sizes: np.ndarray, kept: np.ndarray) -> None:
    """Turn the nodes of all parts but those kept to the outside. parts, sizes: as of `label`."""
    dropped = np.ones(len(sizes), bool)
    dropped[kept] = dropped[0] = False
    _drop(values.reshape(-1), parts.reshape(-1), dropped)


@compiled
def _drop(values: np.ndarray, parts: np.ndarray, dropped: np.ndarray) -> None:
    for node in range(len(values)):
        if dropped[parts[node]]:
            values[node] = np.float32(-0.01)


@compiled
def _points_in(parts: np.ndarray, cells: np.ndarray, count: int) -> np.ndarray:
    """How many points lie in cells (N, 3) with a node of each of `count` parts, the last one of a cell's."""
    points = np.zeros(count, np.int64)
    nx, ny, nz = parts.shape
    for i, j, k in cells:
        if 0 <= i < nx - 1 and 0 <= j < ny - 1 and 0 <= k < nz - 1:
            part = 0
            for a in range(2):
                for b in range(2):
                    for c in range(2):
                        part = max(part, parts[i + a, j + b, k + c])
            points[part] += 1
    return points
