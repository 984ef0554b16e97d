"""Vertices of a marching-cubes surface kept apart, so that no file format joins two of them.

Knows lattices and vertices only. A vertex lies on an edge of the lattice; those near a node are the ones
that come close to each other, less than a file's decimals or single precision tell apart.
"""

from __future__ import annotations

import numpy as np

LEAST_VALUE = np.float32(1e-3)
"""Values nearer to the surface's than this are moved away from it: on a node, vertices of several edges
would be one."""
LEAST_GAP = 1e-3
"""Vertices keep this distance from nodes, in spacings: 5 micrometres on a lattice of 5 mm."""


def off_the_surface(values: np.ndarray) -> np.ndarray:
    """Values on a lattice, none of them within LEAST_VALUE of the surface's, 0."""
    return np.where(np.abs(values) < LEAST_VALUE, -LEAST_VALUE, values)


def apart(vertices: np.ndarray) -> np.ndarray:
    """Vertices (V, 3) in lattice coordinates, moved along their edges so that none is nearer to a node than
    LEAST_GAP."""
    node = np.rint(vertices)
    offset = vertices - node
    # On an edge one coordinate lies between nodes; vertices inside of cells have three that do.
    x, y, z = np.abs(offset).T
    near = (x < LEAST_GAP) & (y < LEAST_GAP) & (z < LEAST_GAP)
    node, offset = node[near], offset[near]
    vertices = vertices.astype(np.float64)
    vertices[near] = np.where(offset != 0, node + np.copysign(LEAST_GAP, offset), vertices[near])
    return vertices
