"""Nodes of a lattice in a solid's hull, as 26 planes around it bound it.

Knows lattices; knows nothing of images, maps or meshes.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

DIRECTIONS = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (0, 1) if (z, y, x) > (0, 0, 0)]
)
"""Normals of the planes, one of each opposite pair."""


@compiled
def in_hull(solid: np.ndarray) -> np.ndarray:
    """Which nodes (nx, ny, nz) bool no plane with one of 26 normals parts from a solid (nx, ny, nz) bool.

    It holds the convex hull, and is not much larger.
    """
    nx, ny, nz = solid.shape
    low, high = np.full(len(DIRECTIONS), nx + ny + nz), np.full(len(DIRECTIONS), -(nx + ny + nz))
    for i in range(nx):
        for j in range(ny):
            first, last = nz, -1
            for k in range(nz):
                if solid[i, j, k]:
                    first, last = min(first, k), k
            if last >= 0:
                for d in range(len(DIRECTIONS)):
                    x, y, z = DIRECTIONS[d]
                    across = x * i + y * j
                    low[d], high[d] = min(low[d], across + z * first), max(high[d], across + z * last)
    inside = np.zeros(solid.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            first, last = 0, nz - 1
            for d in range(len(DIRECTIONS)):
                x, y, z = DIRECTIONS[d]
                across = x * i + y * j
                if z == 1:
                    first, last = max(first, low[d] - across), min(last, high[d] - across)
                elif across < low[d] or across > high[d]:
                    last = -1
            if first <= last:  # an end below 0 would be counted from the far side
                inside[i, j, first : last + 1] = True
    return inside
