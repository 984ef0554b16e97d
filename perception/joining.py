"""What hangs together: points whose voxels touch, and pixels that are joined to their neighbours.

Knows places and images of truth values; knows nothing of depth, labels or objects. Numbers are given in the
order in which things are first met in the image, so that they depend on nothing else.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from mapping.disjoint_sets import join

SCATTER = 0x1E3779B97F4A7C15
"""An odd number that spreads keys over a table when it multiplies them."""


def connected_pieces(joined_right: np.ndarray, joined_down: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Number (H, W) int32 of the piece each pixel of mask (H, W) belongs to, from 1 on; 0 outside the mask.

    joined_right (H, W-1) and joined_down (H-1, W): whether a pixel and the next one are one surface.
    """
    return _pieces(*(np.ascontiguousarray(image) for image in (joined_right, joined_down, mask)))


@compiled
def _pieces(joined_right: np.ndarray, joined_down: np.ndarray, mask: np.ndarray) -> np.ndarray:
    pieces = np.zeros(mask.shape, np.int32)
    parent = np.empty(mask.size + 1, np.int64)
    parent[0] = 0
    count = 1
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            if not mask[row, column]:
                continue
            left = pieces[row, column - 1] if column and joined_right[row, column - 1] else 0
            above = pieces[row - 1, column] if row and joined_down[row - 1, column] else 0
            if left and above:
                join(parent, left, above)
            elif not left and not above:
                parent[count] = left = count
                count += 1
            pieces[row, column] = max(left, above)
    number = _numbers(parent[:count])
    for row in range(mask.shape[0]):
        for column in range(mask.shape[1]):
            pieces[row, column] = number[pieces[row, column]]
    return pieces


@compiled
def connected_points(points: np.ndarray, scale: float) -> np.ndarray:
    """Number (N,) int64 of the cluster each of points (N, 3) belongs to: voxels that touch, even by a corner.

    scale: voxels in a metre.
    """
    key, steps = _voxel_keys(points, scale)
    mask = 1
    while mask < 2 * len(key):
        mask *= 2
    mask -= 1
    table = np.full(mask + 1, -1, np.int64)  # the voxel that each place holds
    voxel, keys, count = np.empty(len(key), np.int64), np.empty(len(key), np.int64), 0
    for point in range(len(key)):
        if point and key[point] == key[point - 1]:  # neighbours in a row mostly share their voxel
            voxel[point] = voxel[point - 1]
            continue
        place = _place(table, keys, key[point])
        if table[place] < 0:
            table[place], keys[count] = count, key[point]
            count += 1
        voxel[point] = table[place]
    parent = np.arange(count)
    for one in range(count):
        for step in steps:
            other = table[_place(table, keys, keys[one] + step)]
            if other >= 0:
                join(parent, one, other)
    return _numbers(parent)[voxel]


@compiled
def _voxel_keys(points: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """A number (N,) for the voxel of each point, and what is added to it (13,) for half of its neighbours."""
    key, steps = np.zeros(len(points), np.int64), np.zeros(13, np.int64)
    for axis in range(3):
        low = high = np.floor(points[0, axis] * scale)
        for point in range(len(points)):
            low = min(low, np.floor(points[point, axis] * scale))
            high = max(high, np.floor(points[point, axis] * scale))
        width = np.int64(high - low) + 2  # the last voxel of a row is empty: rows do not touch
        for point in range(len(points)):
            key[point] = key[point] * width + np.int64(np.floor(points[point, axis] * scale) - low)
        for step in range(13):  # 14..26 in base 3: the neighbours behind one's own voxel, which is 13
            steps[step] = steps[step] * width + (step + 14) // 3 ** (2 - axis) % 3 - 1
    return key, steps


@compiled
def _place(table: np.ndarray, keys: np.ndarray, key: int) -> int:
    """Where the table (a power of two) holds the voxel with a key, or could hold it."""
    place = (key * SCATTER >> 20) & (len(table) - 1)
    while table[place] >= 0 and keys[table[place]] != key:
        place = (place + 1) & (len(table) - 1)
    return place


@compiled
def _numbers(parent: np.ndarray) -> np.ndarray:
    """The number of each thing's whole, counted from 0 in the order of the roots."""
    number, count = np.empty(len(parent), np.int64), 0
    for thing in range(len(parent)):
        if parent[thing] == thing:
            number[thing] = count
            count += 1
        else:
            number[thing] = number[parent[thing]]
    return number
