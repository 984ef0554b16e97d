"""Which points are among others, to the bit, or in one cell with another. Knows arrays only."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

_MIX = np.int64(0x2545F4914F6CDD1D)


def among(points: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Where points (N, 3) float32 stand among known ones (M, 3) float32: (N,) int64, -1 if nowhere."""
    return np.asarray(_among(_words(points), _words(known)))


def first_in_cells(points: np.ndarray, size: float) -> np.ndarray:
    """Indices (M,) of the first of points (N, 3) in each cell, between multiples of `size`."""
    return np.asarray(_first_in_cells(np.ascontiguousarray(points), size))


def _words(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points, np.float32).view(np.int32)


@compiled
def _among(asked: np.ndarray, known: np.ndarray) -> np.ndarray:
    bits = 4
    while 1 << bits < 2 * len(known):
        bits += 1
    mask = (1 << bits) - 1
    table = np.full(1 << bits, -1, np.int64)
    for i in range(len(known)):
        slot = _slot(known, i) & mask
        while table[slot] >= 0:
            slot = (slot + 1) & mask
        table[slot] = i
    found = np.full(len(asked), -1, np.int64)
    for i in range(len(asked)):
        slot = _slot(asked, i) & mask
        while table[slot] >= 0:
            if _same(asked, i, known, table[slot]):
                found[i] = table[slot]
                break
            slot = (slot + 1) & mask
    return found


@compiled
def _first_in_cells(points: np.ndarray, size: float) -> np.ndarray:
    cells = np.empty(points.shape, np.int32)
    for i in range(len(points)):
        for axis in range(3):
            cells[i, axis] = np.int32(np.floor(points[i, axis] / size))
    bits = 4
    while 1 << bits < 2 * len(cells):
        bits += 1
    mask = (1 << bits) - 1
    table = np.full(1 << bits, -1, np.int32)
    first, count = np.empty(len(cells), np.int64), 0
    for i in range(len(cells)):
        slot = _slot(cells, i) & mask
        while table[slot] >= 0 and not _same(cells, i, cells, table[slot]):
            slot = (slot + 1) & mask
        if table[slot] < 0:
            table[slot] = i
            first[count] = i
            count += 1
    return first[:count].copy()


@compiled
def _same(words: np.ndarray, i: int, others: np.ndarray, j: int) -> bool:
    return words[i, 0] == others[j, 0] and words[i, 1] == others[j, 1] and words[i, 2] == others[j, 2]


@compiled
def _slot(words: np.ndarray, i: int) -> np.int64:
    mixed = np.int64(words[i, 0])
    for axis in range(1, 3):
        mixed = (mixed * _MIX) ^ (np.int64(words[i, axis]) + (mixed >> 29))
    mixed *= _MIX
    return mixed >> 20
