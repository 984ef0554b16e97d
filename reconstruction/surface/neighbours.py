"""Nodes and cells of a lattice with their neighbours, worked out on the flat array.

Knows lattices only. A step along an axis is a shift of the flat array: one long operation instead of one for
every short row. What a shift carries from one row to the next lands on nodes of a border that is cut off.
"""

from __future__ import annotations

from math import prod

import numpy as np

from mapping.compiled import compiled


def beside(nodes: np.ndarray, corners: bool = True) -> np.ndarray:
    """Nodes (nx, ny, nz) bool and all their neighbours; without corners, those across faces alone."""
    padded = np.pad(nodes, 1)
    flat = padded.reshape(-1)
    wide = flat.copy()
    for step in _steps(padded):
        narrow = wide.copy() if corners else flat
        wide[step:] |= narrow[:-step]
        wide[:-step] |= narrow[step:]
    return wide.reshape(padded.shape)[1:-1, 1:-1, 1:-1]


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
    inner = (slice(1, -1),) * 3
    for best, nothing in ((np.maximum, -np.inf), (np.minimum, np.inf)):
        padded = np.pad(values, 1, constant_values=nothing)
        flat = padded.reshape(-1)
        for step in _steps(padded):
            pairs = best(flat[step:], flat[:-step])
            best(pairs[step:], pairs[:-step], out=flat[step:-step])
        values = padded[inner]
    return values


def spread(values: np.ndarray, factor: int) -> np.ndarray:
    """Values (nx, ny, nz) on `factor` times as many cells an axis, each node's as far as the next node's."""
    for axis in (2, 1, 0):  # along the first axis whole planes are copied, so that comes last
        shape = list(values.shape)
        shape[axis] = factor * (shape[axis] - 1) + 1
        fine = np.empty(shape, values.dtype)
        part, nodes = ([slice(None)] * 3 for _ in range(2))
        for step in range(factor):
            part[axis], nodes[axis] = slice(step, None, factor), slice(None, -1 if step else None)
            fine[tuple(part)] = values[tuple(nodes)]
        values = fine
    return values


def upsample(values: np.ndarray, factor: int) -> np.ndarray:
    """Linear interpolation of (nx, ny, nz) to factor times as many cells an axis."""
    for axis in (2, 1, 0):  # along the first axis whole planes are added, so that comes last
        shape = list(values.shape)
        shape[axis] = factor * (shape[axis] - 1) + 1
        fine = np.empty(shape, np.float32)
        low, high, part = ([slice(None)] * 3 for _ in range(3))
        part[axis] = slice(None, None, factor)
        fine[tuple(part)] = values
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        for step in range(1, factor):
            share = np.float32(step / factor)
            part[axis] = slice(step, None, factor)
            place = fine[tuple(part)]
            np.multiply(values[tuple(high)], share, out=place)
            place += (1 - share) * values[tuple(low)]
        values = fine
    return values


def nodes_of_cells(cells: np.ndarray, factor: int) -> np.ndarray:
    """Fine nodes (factor n + 1 an axis) in and on coarse cells (n an axis)."""
    fine = spread(np.pad(cells, (0, 1)), factor)
    for step in _steps(fine):
        flat = fine.reshape(-1).copy()
        flat[step:] |= fine.reshape(-1)[:-step]
        fine = flat.reshape(fine.shape)
    return fine


def nodes_off(solid: np.ndarray) -> np.ndarray:
    """How many steps (nx, ny, nz) uint8, also across corners, nodes are from the nearest of solid ones, bool;
    255 and more are 255, as all are where none is solid."""
    off = np.pad(np.where(solid, 0, 255).astype(np.uint8), 1, constant_values=255)
    least = np.empty(off.shape[2], np.uint8)
    _sweep(off, least)
    _sweep(off[::-1, ::-1, ::-1], least)  # from the other end: two sweeps find the least over all ways
    return off[1:-1, 1:-1, 1:-1]


@compiled
def _sweep(off: np.ndarray, least: np.ndarray) -> None:
    """Take into account, row after row, the neighbours that come before; the frame's nodes are no one's."""
    nx, ny, nz = off.shape
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
