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


def off_the_surface(values: np.ndarray) -> np.ndarray:
    """Values on a lattice, none of them within LEAST_VALUE of the surface's, 0."""
    return np.where(np.abs(values) < LEAST_VALUE, -LEAST_VALUE, values)


def apart(vertices: np.ndarray) -> np.ndarray:
    """Vertices (V, 3) in lattice coordinates, moved along their edges so that none is nearer to a node than
    LEAST_GAP."""
    moved = vertices.astype(np.float64)
    _move_apart(vertices, moved)
    return moved


@compiled
def _move_apart(vertices: np.ndarray, moved: np.ndarray) -> None:
    for v in range(len(vertices)):
        near = (
            True  # on an edge one coordinate lies between nodes; vertices inside of cells have three that do
        )
        for axis in range(3):
            near &= abs(vertices[v, axis] - np.rint(vertices[v, axis])) < LEAST_GAP
        if near:
            for axis in range(3):
                node = np.rint(vertices[v, axis])
                offset = vertices[v, axis] - node
                if offset != 0:
                    moved[v, axis] = node + (LEAST_GAP if offset > 0 else -LEAST_GAP)
