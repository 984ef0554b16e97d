"""Vertices of a marching-cubes surface kept apart, so that no file format joins two of them.

Knows lattices and vertices only. A vertex lies on an edge of the lattice; those near a node are the ones
that come close to each other, less than a file's decimals or single precision tell apart.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

LEAST_VALUE = np.float32(1e-3)
"""Values nearer to the surface's than this are moved away from it: on a node, vertices of several edges
would be one."""
LEAST_GAP = np.float32(1e-3)
"""Vertices keep this distance from nodes, in spacings: 5 micrometres on a lattice of 5 mm."""


@compiled
def off_the_surface(values: np.ndarray) -> np.ndarray:
    """Values on a lattice, none of them within LEAST_VALUE of the surface's, 0."""
    moved = np.empty_like(values)
    before, after = values.reshape(-1), moved.reshape(-1)
    for node in range(len(before)):
        after[node] = before[node] if abs(before[node]) >= LEAST_VALUE else -LEAST_VALUE
    return moved


@compiled
def apart(vertices: np.ndarray) -> np.ndarray:
    """Vertices (V, 3) in lattice coordinates, moved along their edges so that none is nearer to a node than
    LEAST_GAP."""
    moved = vertices.astype(np.float64)
    nodes = np.rint(vertices)
    offsets = vertices - nodes
    for v in range(len(vertices)):
        x, y, z = offsets[v]
        # On an edge one coordinate lies between nodes; vertices inside of cells have three that do.
        if abs(x) < LEAST_GAP and abs(y) < LEAST_GAP and abs(z) < LEAST_GAP:
            for axis in range(3):
                if offsets[v, axis] != 0:
                    moved[v, axis] = nodes[v, axis] + np.copysign(LEAST_GAP, offsets[v, axis])
    return moved
