"""Cells of a lattice in which an object was seen, and nodes that keep them in its mesh. Knows lattices and
points only."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


def cells_with(points: np.ndarray, corner: np.ndarray, spacing: float, shape: tuple[int, ...]) -> np.ndarray:
    """Cells (nx - 1, ny - 1, nz - 1) bool that hold a point (N, 3) float32, and those beside them.

    shape: of the lattice's nodes; they are at corner + spacing * (i, j, k) [m].
    """
    nx, ny, nz = shape
    held = np.zeros((nx - 1, ny - 1, nz - 1), bool)
    _mark_cells(held, np.ascontiguousarray(points), corner, np.float32(spacing))
    return held


@compiled
def _mark_cells(held: np.ndarray, points: np.ndarray, corner: np.ndarray, spacing: float) -> None:
    nx, ny, nz = held.shape
    first = corner.astype(np.float32)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if x >= corner[0] and y >= corner[1] and z >= corner[2]:
            i, j, k = (
                int((x - first[0]) / spacing),
                int((y - first[1]) / spacing),
                int((z - first[2]) / spacing),
            )
            if i < nx and j < ny and k < nz:
                held[i, j, k] = True
                held[max(i - 1, 0), j, k] = held[min(i + 1, nx - 1), j, k] = True
                held[i, max(j - 1, 0), k] = held[i, min(j + 1, ny - 1), k] = True
                held[i, j, max(k - 1, 0)] = held[i, j, min(k + 1, nz - 1)] = True


def nodes_of_seen_cells(
    values: np.ndarray,
    origin: np.ndarray,
    spacing: float,
    points: np.ndarray,
    surface: float,
    least: float,
    beside: bool = True,
) -> tuple[np.ndarray, ...]:
    """Indices of nodes to take into an object so that no cell with a seen point (N, 3) is without it.

    Things thinner than a cell fall between the nodes of a lattice, and a mesh of them is lace or fragments.
    Where none of a cell's eight nodes has a value above `surface`, the one with the largest is found,
    unless the map rules it out with a value of `least` or below. values: (nx, ny, nz) at origin + spacing *
    (i, j, k) [m]. beside: False where a node above `surface` next to the cell will do as well.
    """
    values, points = np.ascontiguousarray(values), np.ascontiguousarray(points)
    limits = values.dtype.type(surface), values.dtype.type(least)
    nodes = _likeliest(values, origin.astype(float), spacing, points, *limits, beside)
    return np.unravel_index(nodes, values.shape)


@compiled
def _likeliest(
    values: np.ndarray,
    origin: np.ndarray,
    spacing: float,
    points: np.ndarray,
    surface: float,
    least: float,
    beside: bool,
) -> np.ndarray:
    """The flat nodes (M,) that `nodes_of_seen_cells` tells."""
    nx, ny, nz = values.shape
    known = np.zeros(values.shape, np.bool_)  # thousands of points lie in hundreds of cells
    nodes, count = np.empty(len(points), np.int64), 0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i = int(np.floor((x - origin[0]) / spacing))
        j = int(np.floor((y - origin[1]) / spacing))
        k = int(np.floor((z - origin[2]) / spacing))
        if not (0 <= i < nx - 1 and 0 <= j < ny - 1 and 0 <= k < nz - 1) or known[i, j, k]:
            continue
        known[i, j, k] = True
        most, node = values[i, j, k], (i * ny + j) * nz + k
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    value = values[i + a, j + b, k + c]
                    if value > most:
                        most, node = value, ((i + a) * ny + j + b) * nz + k + c
        if least < most <= surface and (beside or not _any_around(values, i, j, k, surface)):
            nodes[count] = node
            count += 1
    return nodes[:count].copy()


@compiled
def _any_around(values: np.ndarray, i: int, j: int, k: int, surface: float) -> bool:
    """Whether any node of the cell with first node (i, j, k), or next to it, is above `surface`."""
    nx, ny, nz = values.shape
    for a in range(max(i - 1, 0), min(i + 3, nx)):
        for b in range(max(j - 1, 0), min(j + 3, ny)):
            for c in range(max(k - 1, 0), min(k + 3, nz)):
                if values[a, b, c] > surface:
                    return True
    return False
