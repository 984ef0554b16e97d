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
    for i in range(nx):
        for j in range(ny):
            first = (i * ny + j) * nz
            for across, along, inner in (
                (ny * nz, nz, i + 1 < nx and j + 1 < ny),
                (ny * nz, 1, i + 1 < nx),
                (nz, 1, j + 1 < ny),
            ):
                if not inner:
                    continue
                for a in range(first, first + nz - (along == 1)):
                    here = flat[a] > 0
                    if here == (flat[a + across + along] > 0):
                        beside = flat[a + across] > 0
                        if beside != here and beside == (flat[a + along] > 0):
                            b, c = (a + across, a + along) if here else (a, a + across + along)
                            node = b if flat[b] >= flat[c] else c
                            if flat[node] > least:
                                found.append(node)
    return np.array(found, np.int64)
