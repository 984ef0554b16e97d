"""Nodes and cells of a lattice with their neighbours, worked out on the flat array.

Knows lattices only. A step along an axis is a shift of the flat array: one long operation instead of one for
every short row. What a shift carries from one row to the next lands on nodes of a border that is cut off.
"""

from __future__ import annotations

from math import prod

import numpy as np

from mapping.compiled import compiled


def beside(nodes: np.ndarray) -> np.ndarray:
    """Nodes (nx, ny, nz) bool and all their neighbours, also across corners."""
    return _greatest_around(np.ascontiguousarray(nodes).view(np.uint8)).view(bool)


@compiled
def _greater(a: float, b: float) -> float:
    """As max(a, b), which minds numbers that are none, and takes many times as long."""
    return a if a > b else b


def range_in_cells(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest value at the nodes of each cell (nx - 1, ny - 1, nz - 1)."""
    found = []
    for best in (np.minimum, np.maximum):
        flat = values.reshape(-1).copy()
        for step in _steps(values):  # the last nodes, beyond which there are none, are cut off below
            flat[:-step] = best(flat[:-step], flat[step:])
        found.append(flat.reshape(values.shape)[:-1, :-1, :-1])
    return found[0], found[1]


def closed(values: np.ndarray) -> np.ndarray:
    """Grey closing of (nx, ny, nz) float32 by a cube of 3 nodes a side."""
    return -_greatest_around(-_greatest_around(np.ascontiguousarray(values)))


@compiled
def _greatest_around(values: np.ndarray) -> np.ndarray:
    """The greatest of each node (nx, ny, nz) and all its neighbours: along one axis after the other."""
    nx, ny, nz = values.shape
    found, wide = np.empty_like(values), np.empty_like(values)
    for i in range(nx):
        for j in range(ny):
            row, best = values[i, j], wide[i, j]
            best[0] = row[0]
            for k in range(1, nz):
                best[k] = _greater(row[k], row[k - 1])
            for k in range(nz - 1):
                best[k] = _greater(best[k], row[k + 1])
    for i in range(nx):
        for j in range(ny):
            before, own, after = wide[i, max(j - 1, 0)], wide[i, j], wide[i, min(j + 1, ny - 1)]
            best = found[i, j]
            for k in range(nz):
                best[k] = _greater(_greater(before[k], own[k]), after[k])
    for i in range(nx):
        for j in range(ny):
            before, own, after = found[max(i - 1, 0), j], found[i, j], found[min(i + 1, nx - 1), j]
            best = wide[i, j]
            for k in range(nz):
                best[k] = _greater(_greater(before[k], own[k]), after[k])
    return wide


def smoothed(values: np.ndarray, sigma: float) -> np.ndarray:
    """A Gaussian of some nodes over (nx, ny, nz) float32, mirrored at the border: as scipy.ndimage's."""
    reach = int(4 * sigma + 0.5)
    weights = np.exp(-0.5 / sigma**2 * np.arange(-reach, reach + 1) ** 2)
    weights = (weights / weights.sum())[reach:]
    along = values
    for _ in range(3):  # along the first axis, which then becomes the last
        along = np.ascontiguousarray(np.moveaxis(_smoothed_along(np.ascontiguousarray(along), weights), 0, 2))
    return along


@compiled
def _smoothed_along(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The same along the first axis alone; weights: of the node itself, of both beside it, and so on."""
    nx, ny, nz = values.shape
    found, total = np.empty_like(values), np.empty(nz, np.float64)
    for i in range(nx):
        for j in range(ny):
            own = values[i, j]
            for k in range(nz):
                total[k] = own[k] * weights[0]
            for step in range(len(weights) - 1, 0, -1):
                before, after = values[_mirrored(i - step, nx), j], values[_mirrored(i + step, nx), j]
                for k in range(nz):
                    total[k] += (np.float64(before[k]) + np.float64(after[k])) * weights[step]
            for k in range(nz):
                found[i, j, k] = total[k]
    return found


@compiled
def _mirrored(index: int, count: int) -> int:
    """An index beyond an axis of some length, mirrored at its ends."""
    index %= 2 * count
    return min(index, 2 * count - 1 - index)


def nodes_off(solid: np.ndarray) -> np.ndarray:
    """How many steps (nx, ny, nz) uint8, also across corners, nodes are from the nearest of solid ones, bool;
    255 and more are 255, as all are where none is solid."""
    off = np.full([count + 2 for count in solid.shape], 255, np.uint8)
    off[1:-1, 1:-1, 1:-1][solid] = 0
    for _ in range(2):  # from one end and from the other: two sweeps find the least over all ways
        _sweep(off)
        off = np.ascontiguousarray(off[::-1, ::-1, ::-1])
    return off[1:-1, 1:-1, 1:-1]


@compiled
def _sweep(off: np.ndarray) -> None:
    """Take into account, row after row, the neighbours that come before; the frame's nodes are no one's."""
    nx, ny, nz = off.shape
    least = np.empty(nz, np.uint8)
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            row, a, b, c, d = off[i, j], off[i, j - 1], off[i - 1, j - 1], off[i - 1, j], off[i - 1, j + 1]
            for k in range(nz):
                least[k] = min(min(a[k], b[k]), min(c[k], d[k]))
            before = np.uint8(255)
            for k in range(1, nz - 1):
                found = min(min(least[k - 1], least[k]), min(least[k + 1], before))
                before = min(row[k], np.uint8(found + (found < 255)))
                row[k] = before


def _steps(lattice: np.ndarray) -> list[int]:
    """From a node to the next one along each axis, in the flat array; the last axis first."""
    return [prod(lattice.shape[axis + 1 :]) for axis in (2, 1, 0)]
