"""Which whole numbers are the same, by hashing: in proportion to their count, however many there are.

Knows numbers; must not know what they stand for.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

SMALLEST_TABLE = 1 << 12
MIX = 0x1E3779B97F4A7C15
"""An odd number: products with it differ in their upper bits, which are folded on the lower ones."""


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of keys (N,) int64 the places (M,) where each one is for the first time, in that order; and for every
    key which of them it is (N,)."""
    first, group = np.empty(len(keys), np.int64), np.empty(len(keys), np.int64)
    count = _group(np.ascontiguousarray(keys, np.int64), first, group)
    return first[:count].copy(), group


@compiled
def _group(keys: np.ndarray, first: np.ndarray, group: np.ndarray) -> int:
    """Fill first and group; how many distinct keys there are. The table grows with them, so that few stay in
    the processor's cache."""
    table, found, count = np.full(SMALLEST_TABLE, -1, np.int64), np.empty(len(keys), np.int64), 0
    for i in range(len(keys)):
        place = _place(keys[i], table, found)
        if table[place] < 0:
            table[place], found[count], first[count] = count, keys[i], i
            count += 1
        group[i] = table[place]
        if 2 * count > len(table):
            table = np.full(4 * len(table), -1, np.int64)
            for known in range(count):
                table[_place(found[known], table, found)] = known
    return count


@compiled
def _place(key: int, table: np.ndarray, found: np.ndarray) -> int:
    """Where a key is in the table, whose size is a power of two, or where it belongs."""
    mixed = (key ^ (key >> 32)) * MIX
    at = (mixed ^ (mixed >> 32)) & (len(table) - 1)
    while table[at] >= 0 and found[table[at]] != key:
        at = (at + 1) & (len(table) - 1)
    return at
