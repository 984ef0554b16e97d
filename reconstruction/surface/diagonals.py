"""Nodes of a lattice that join diagonal neighbours: a sheet about as thick as a cell has no holes then.

Knows lattices only.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


def between_diagonals(values: np.ndarray, least: float) -> tuple[np.ndarray, ...]:
    """Indices of nodes to take into an object so that nodes inside that face each other across a square are
    joined. Marching cubes keep them apart, and a sheet that steps from one to the other has a hole there.

    Of the other two nodes, both outside, the one with the larger value is found, unless that is `least` or
    below. values: (nx, ny, nz), inside above 0.
    """
    nodes = _between_diagonals(np.ascontiguousarray(values), values.dtype.type(least))
    return np.unravel_index(nodes, values.shape)


@compiled
def _between_diagonals(values: np.ndarray, least: float) -> np.ndarray:
    """The flat nodes (M,) that `between_diagonals` tells."""
    nx, ny, nz = values.shape
    flat, found = values.reshape(-1), []
    inside = np.empty(len(flat), np.uint8)
    for a in range(len(flat)):
        inside[a] = flat[a] > 0
    crossed = np.empty(nz, np.uint8)
    for i in range(nx):
        for j in range(ny):
            first = (i * ny + j) * nz
            for across, along, inner in (
                (ny * nz, nz, i + 1 < nx and j + 1 < ny),
                (ny * nz, 1, i + 1 < nx),
                (nz, 1, j + 1 < ny),
            ):
                count = nz - (along == 1)
                if not inner or not _any_crossed(inside, first, across, along, count, crossed):
                    continue
                for k in range(count):
                    if crossed[k]:
                        a = first + k
                        b, c = (a + across, a + along) if inside[a] else (a, a + across + along)
                        node = b if flat[b] >= flat[c] else c
                        if flat[node] > least:
                            found.append(node)
    return np.array(found, np.int64)


@compiled
def _any_crossed(
    inside: np.ndarray, first: int, across: int, along: int, count: int, crossed: np.ndarray
) -> bool:
    """Whether in any square, from `count` nodes on in a row, only opposite corners are inside; tells in
    `crossed` of each."""
    a, b = inside[first : first + count], inside[first + across : first + across + count]
    c = inside[first + along : first + along + count]
    d = inside[first + across + along : first + across + along + count]
    some = np.uint8(0)
    for k in range(count):
        # Bit by bit, not with `and`: these loops become vectors.
        crossed[k] = (a[k] ^ b[k]) & (a[k] ^ c[k]) & (b[k] ^ d[k])
        some |= crossed[k]
    return some != 0
