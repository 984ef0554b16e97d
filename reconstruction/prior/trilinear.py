"""Values between the cells of a small lattice, for many points at once.

What torch's grid_sample gives with border padding, several times as fast: neighbours and their weights are
worked out once for all channels, and each neighbour's channels can be read in one piece.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def corners(axes: np.ndarray, shape: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """The eight cells around N points, and their weights: (8, N) int32 and (8, N) float32, summing to 1.

    axes: (3, N) float32, -1 to 1 from end to end of the lattice along each axis; beyond it, the nearest cells
    count. Cells are counted in the flat lattice of `shape`, last axis fastest; their centres lie half a cell
    inside.
    """
    size = np.array(shape, np.float32)[:, None]
    place = (axes + 1) * (size / 2)
    place -= 0.5
    np.maximum(place, 0, out=place)
    np.minimum(place, size - 1, out=place)
    first = np.minimum(place.astype(np.int32), size.astype(np.int32) - 2)
    place -= first
    x, y, z = np.stack([1 - place, place], axis=1)  # (2, N) each
    weights = x[:, None, None] * (y[:, None] * z)
    _, ny, nz = shape
    steps = np.add.outer(np.add.outer((0, ny * nz), (0, nz)), (0, 1)).astype(np.int32)
    index = (first[0] * ny + first[1]) * nz + first[2] + steps.reshape(8, 1)
    return index, weights.reshape(8, -1)
