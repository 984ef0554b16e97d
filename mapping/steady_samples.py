"""Samples that stay where they are: what is drawn at a place depends on the place and a seed alone.

Knows points, lattices of multiples of a spacing, and seeds; knows nothing of what samples are for. A box that
grows gains samples and keeps the ones it had, so that what was worked out for these need not be again.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from mapping.samples import LARGEST_TABLE

_ONE = np.uint64(0x9E3779B97F4A7C15)
_TWO = np.uint64(0xBF58476D1CE4E5B9)
_THREE = np.uint64(0x94D049BB133111EB)
_A, _B, _C, _TOP = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_UNIT = 1.0 / (1 << 53)


def steady_lattice(low: np.ndarray, high: np.ndarray, spacing: float, seed: int) -> np.ndarray:
    """One uniform sample (M, 3) float32 in each cell, between multiples of `spacing`, that a box low..high
    (3,) reaches into."""
    first = np.floor(np.asarray(low, float) / spacing + 1e-6).astype(np.int64)
    last = np.ceil(np.asarray(high, float) / spacing - 1e-6).astype(np.int64)
    return np.asarray(_in_cells(first, np.maximum(last - first, 1), spacing, _salt(seed, spacing)))


def steady_jitter(points: np.ndarray, spacing: float, seed: int) -> np.ndarray:
    """Lattice points (N, 3), multiples of `spacing`, moved within the cells around them."""
    cells = np.rint(points / spacing).astype(np.int64)
    return np.asarray(_around(cells, spacing, _salt(seed, spacing)))


def steady_chance(points: np.ndarray, seed: int) -> np.ndarray:
    """A number in [0, 1) for each point (N, 3) float32, by its place: (N,)."""
    return np.asarray(_marks(_bits(points), _salt(seed, 1.0)) * _UNIT)


def steady_subsample(points: np.ndarray, order: np.ndarray, size: float, seed: int) -> np.ndarray:
    """Indices (M,) of one point in each cell, between multiples of `size`, that holds any of points (N, 3)
    float32: one of those first in `order` (N,) int, whichever the seed picks."""
    if len(points) == 0:
        return np.empty(0, np.int64)
    points = np.ascontiguousarray(points, np.float32)
    key, count = _cells(points, size)
    if count > max(LARGEST_TABLE * len(points), 1 << 16):
        filled, key = np.unique(key, return_inverse=True)
        count = len(filled)
    return np.asarray(_first_of_each(key, order, points.view(np.int32), _salt(seed, size), count))


@compiled
def _cells(points: np.ndarray, size: float) -> tuple[np.ndarray, int]:
    """The cell, between multiples of `size`, of each of points (N, 3), as one number (N,) of the box that
    holds them all, and how many cells that has."""
    cells = np.empty(points.shape, np.int32)
    flat, coordinates = cells.reshape(-1), points.reshape(-1)
    for i in range(len(flat)):
        flat[i] = np.int32(np.floor(np.float64(coordinates[i]) / size))
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        least = most = cells[0, axis]
        for i in range(len(points)):
            least, most = min(least, cells[i, axis]), max(most, cells[i, axis])
        low[axis], high[axis] = least, most
    extent, key = high - low + 1, np.empty(len(points), np.int64)
    for i in range(len(points)):
        x, y, z = cells[i, 0] - low[0], cells[i, 1] - low[1], cells[i, 2] - low[2]
        key[i] = (x * extent[1] + y) * extent[2] + z
    return key, extent[0] * extent[1] * extent[2]


def _bits(points: np.ndarray) -> np.ndarray:
    """Coordinates (N, 3) float32 as whole numbers."""
    return np.ascontiguousarray(points, np.float32).view(np.int32).astype(np.int64)


def _salt(seed: int, spacing: float) -> np.uint64:
    """Lattices of other spacings draw other numbers."""
    return np.uint64((seed * 0x9E3779B97F4A7C15 + round(1e7 * spacing)) % (1 << 64))


@compiled
def _mark(x: int, y: int, z: int, salt: np.uint64) -> np.uint64:
    """53 bits that look random (splitmix64)."""
    mixed = salt
    for word in (np.uint64(x), np.uint64(y), np.uint64(z)):
        mixed = (mixed ^ word) + _ONE
        mixed = (mixed ^ (mixed >> _A)) * _TWO
        mixed = (mixed ^ (mixed >> _B)) * _THREE
        mixed = mixed ^ (mixed >> _C)
    return mixed >> _TOP


@compiled
def _marks(words: np.ndarray, salt: np.uint64) -> np.ndarray:
    marks = np.empty(len(words), np.uint64)
    for i in range(len(words)):
        marks[i] = _mark(words[i, 0], words[i, 1], words[i, 2], salt)
    return marks


@compiled
def _in_cells(first: np.ndarray, count: np.ndarray, spacing: float, salt: np.uint64) -> np.ndarray:
    points = np.empty((count[0] * count[1] * count[2], 3), np.float32)
    n = 0
    for i in range(first[0], first[0] + count[0]):
        for j in range(first[1], first[1] + count[1]):
            for k in range(first[2], first[2] + count[2]):
                x = _mark(i, j, k, salt)
                y = _mark(i, j, k, x)
                points[n, 0] = (i + x * _UNIT) * spacing
                points[n, 1] = (j + y * _UNIT) * spacing
                points[n, 2] = (k + _mark(i, j, k, y) * _UNIT) * spacing
                n += 1
    return points


@compiled
def _around(cells: np.ndarray, spacing: float, salt: np.uint64) -> np.ndarray:
    points = np.empty(cells.shape, np.float32)
    for n in range(len(cells)):
        mark = salt
        for axis in range(3):
            mark = _mark(cells[n, 0], cells[n, 1], cells[n, 2], mark)
            points[n, axis] = (cells[n, axis] + mark * _UNIT - 0.5) * spacing
    return points


@compiled
def _first_of_each(
    key: np.ndarray, order: np.ndarray, words: np.ndarray, salt: np.uint64, count: int
) -> np.ndarray:
    """Of points in cells `key` (N,) the first of each, by order (N,), then by the marks of words (N, 3):
    indices in ascending order."""
    best, least = np.full(count, -1, np.int32), np.empty(count, np.uint64)
    for i in range(len(key)):
        cell = key[i]
        other = best[cell]
        if other >= 0 and order[i] > order[other]:
            continue  # most points of a surface that was seen before
        mark = _mark(np.int64(words[i, 0]), np.int64(words[i, 1]), np.int64(words[i, 2]), salt)
        if other < 0 or order[i] < order[other] or mark < least[cell]:
            best[cell], least[cell] = i, mark
    chosen = np.zeros(len(key), np.bool_)
    for found in best:
        if found >= 0:
            chosen[found] = True
    return np.flatnonzero(chosen)
