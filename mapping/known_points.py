"""Which points are among others, to the bit: what was worked out for those is known. Knows arrays only."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

_MIX = np.int64(0x2545F4914F6CDD1D)


def among(points: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Where points (N, 3) float32 stand among known ones (M, 3) float32: (N,) int64, -1 if nowhere."""
    return np.asarray(_among(_words(points), _words(known)))


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
            other = table[slot]
            if (
                known[other, 0] == asked[i, 0]
                and known[other, 1] == asked[i, 1]
                and known[other, 2] == asked[i, 2]
            ):
                found[i] = other
                break
            slot = (slot + 1) & mask
    return found


@compiled
def _slot(words: np.ndarray, i: int) -> np.int64:
    mixed = np.int64(words[i, 0])
    for axis in range(1, 3):
        mixed = (mixed * _MIX) ^ (np.int64(words[i, axis]) + (mixed >> 29))
    mixed *= _MIX
    return mixed >> 20
