"""Which points lie near any of many others, in time that grows with both and not with pairs. Knows points."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

MOST_CELLS = 1 << 22
"""Cells are made larger where a table of them would be."""


def near_any(points: np.ndarray, others: np.ndarray, distance: float) -> np.ndarray:
    """Mask (N,): points (N, 3) float32 within `distance` of any of others (M, 3) float32."""
    if not len(points) or not len(others):
        return np.zeros(len(points), bool)
    axes = np.ascontiguousarray(points.T)
    low, high = axes.min(1) - distance, axes.max(1) + distance
    size = distance
    while np.prod(np.floor((high - low) / size) + 1) > MOST_CELLS:
        size *= 2
    count = np.floor((high - low) / size).astype(np.int64) + 1
    return np.asarray(
        _near(np.ascontiguousarray(points), np.ascontiguousarray(others), low, count, size, distance)
    )


@compiled
def _near(
    points: np.ndarray, others: np.ndarray, low: np.ndarray, count: np.ndarray, size: float, distance: float
) -> np.ndarray:
    """The others in each cell are a chain: its first, and after each the next."""
    nx, ny, nz = count
    first = np.full(nx * ny * nz, -1, np.int32)
    after = np.empty(len(others), np.int32)
    for n in range(len(others)):
        i = int(np.floor((others[n, 0] - low[0]) / size))
        j = int(np.floor((others[n, 1] - low[1]) / size))
        k = int(np.floor((others[n, 2] - low[2]) / size))
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            cell = (i * ny + j) * nz + k
            after[n] = first[cell]
            first[cell] = n
    limit = distance * distance
    near = np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i, j, k = int((x - low[0]) / size), int((y - low[1]) / size), int((z - low[2]) / size)
        for a in range(max(i - 1, 0), min(i + 2, nx)):
            for b in range(max(j - 1, 0), min(j + 2, ny)):
                for c in range(max(k - 1, 0), min(k + 2, nz)):
                    other = first[(a * ny + b) * nz + c]
                    while other >= 0 and not near[n]:
                        dx, dy = others[other, 0] - x, others[other, 1] - y
                        dz = others[other, 2] - z
                        near[n] = dx * dx + dy * dy + dz * dz <= limit
                        other = after[other]
    return near
