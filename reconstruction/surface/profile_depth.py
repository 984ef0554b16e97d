"""How deep places of a half plane lie behind a body of revolution's profile.

Knows points of the profile, their normals, and which places are empty; knows nothing of images, axes or maps.
The half plane is that of radius and height; its cells are squares.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from mapping.compiled import compiled

CELL = 0.002
"""Cells of the half plane [m]."""
NEAR, BESIDE = 0.006, 0.003
"""The profile is known within this distance across it, and beyond its ends [m]; twice as far beyond where no
ray passed."""
EMPTY, UNKNOWN = np.float32(-0.008), np.float32(0.02)
"""Depths [m] where rays passed, and where nothing is known."""
NEIGHBOURS = 12
"""So many measured points nearby say how deep a place is: with fewer, noise makes steps."""
FLOOR = 0.7
"""Normals that point down more than this belong to the inside: a bowl's floor."""
THINNEST = 0.0045
"""A wall of which both sides are known is at least so thick [m]: less falls between a lattice's nodes."""
SLIT = 3
"""Gaps of fewer cells in the table are closed."""
_RINGS = round(2 * NEAR / CELL)
"""Measured points are looked for within so many cells ..."""
_REACH = int(np.ceil(np.hypot(NEAR, 2 * BESIDE) / CELL))
"""... where one is within so many: no place farther away is known."""


def depth_table(profile: np.ndarray, inwards: np.ndarray, low: float, empty: np.ndarray) -> np.ndarray:
    """How far places (R, Z), `CELL` apart in radius from 0 on and in height from `low` [m] on, lie behind the
    surface: float32 [m], EMPTY or so where rays passed, UNKNOWN or so where nothing is known.

    profile: (M, 2) radii and heights of surface points [m]; inwards: (M, 2) their normals, into the body;
    empty: (R, Z) bool, what rays passed.
    """
    profile = np.ascontiguousarray(profile - np.array([0, low]), np.float64)
    inwards = np.ascontiguousarray(inwards, np.float64)
    beyond = np.where(empty, BESIDE, 2 * BESIDE)
    outer = (inwards[:, 0] < 0) & (inwards[:, 1] > -FLOOR)
    sides = sorted((outer, ~outer), key=np.count_nonzero)
    less, more = (_depth_behind(profile[side], inwards[side], beyond) for side in sides)
    # A wall's two sides are known to a millimetre or two, and some walls are no thicker: the side of which
    # more was seen stays where it is.
    both = np.isfinite(less) & np.isfinite(more)
    lacking = np.maximum(THINNEST - np.where(both, less + more, THINNEST), 0)
    depth = np.where(both, np.minimum(less + lacking, more), np.maximum(less, more))
    depth = np.where(np.isfinite(depth), depth, np.where(empty, EMPTY, UNKNOWN)).astype(np.float32)
    return ndimage.grey_closing(depth, SLIT)


@compiled
def _depth_behind(profile: np.ndarray, inwards: np.ndarray, beyond: np.ndarray) -> np.ndarray:
    """How far places (R, Z) are behind the profile (M, 2) of one side of a wall [m], -inf where that is not
    known: `beyond` (R, Z) [m] its ends. Of the nearest measured points, the mean."""
    rows, columns = beyond.shape
    behind = np.full(beyond.shape, -np.inf)
    starts, order = _by_cell(profile, rows, columns)
    distance, nearest = np.empty(NEIGHBOURS), np.empty(NEIGHBOURS, np.int64)
    for r, c in np.argwhere(_around_points(starts, rows, columns)):
        count = _nearest(r, c, profile, starts, order, rows, columns, distance, nearest)
        deep = 0.0
        for n in range(count):
            x, y = r * CELL - profile[nearest[n], 0], c * CELL - profile[nearest[n], 1]
            deep += x * inwards[nearest[n], 0] + y * inwards[nearest[n], 1]
        deep /= max(count, 1)
        aside = np.sqrt(max(distance[0] - deep * deep, 0.0))
        if count and aside < beyond[r, c] and abs(deep) < NEAR:
            behind[r, c] = deep
    return behind


@compiled
def _by_cell(points: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (M,) of points (M, 2) [m] in the order of their cells, row by row, and where each cell's start:
    (rows * columns + 1,)."""
    cell = np.empty(len(points), np.int64)
    starts = np.zeros(rows * columns + 1, np.int64)
    for i in range(len(points)):
        r = min(max(int(points[i, 0] / CELL), 0), rows - 1)
        cell[i] = r * columns + min(max(int(points[i, 1] / CELL), 0), columns - 1)
        starts[cell[i] + 1] += 1
    starts = np.cumsum(starts)
    free, order = starts.copy(), np.empty(len(points), np.int64)
    for i in range(len(points)):
        order[free[cell[i]]] = i
        free[cell[i]] += 1
    return starts, order


@compiled
def _around_points(starts: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Which places (R, Z) are within reach of a point; starts: as `_by_cell` gives them."""
    found = np.zeros((rows, columns), np.bool_)
    for cell in range(rows * columns):
        if starts[cell] < starts[cell + 1]:
            r, c = cell // columns, cell % columns
            found[max(r - _REACH + 1, 0) : r + _REACH + 1, max(c - _REACH + 1, 0) : c + _REACH + 1] = True
    return found


@compiled
def _nearest(
    r: int,
    c: int,
    points: np.ndarray,
    starts: np.ndarray,
    order: np.ndarray,
    rows: int,
    columns: int,
    distance: np.ndarray,
    nearest: np.ndarray,
) -> int:
    """How many points (M, 2) near the place (r, c) are found, the nearest first: their squared distances and
    numbers are put into `distance` and `nearest` (NEIGHBOURS,)."""
    count = 0
    for ring in range(_RINGS):
        for i in range(max(r - ring - 1, 0), min(r + ring + 1, rows)):
            whole = i == r - ring - 1 or i == r + ring
            step = 1 if whole else 2 * ring + 1
            for j in range(c - ring - 1, c + ring + 1, step):
                if j < 0 or j >= columns:
                    continue
                cell = i * columns + j
                for n in order[starts[cell] : starts[cell + 1]]:
                    far = (r * CELL - points[n, 0]) ** 2 + (c * CELL - points[n, 1]) ** 2
                    count = _insert(far, n, distance, nearest, count)
        # All that is no farther than this has been looked at.
        seen = (ring + 1) * CELL
        if count == len(distance) and distance[count - 1] <= seen * seen:
            break
    while count and distance[count - 1] > (2 * NEAR) ** 2:
        count -= 1
    return count


@compiled
def _insert(far: float, number: int, distance: np.ndarray, nearest: np.ndarray, count: int) -> int:
    """Put one more into `distance` and `nearest` if it is among the nearest; how many there are then."""
    if count == len(distance):
        if far >= distance[count - 1]:
            return count
        count -= 1
    at = count
    while at > 0 and distance[at - 1] > far:
        distance[at], nearest[at] = distance[at - 1], nearest[at - 1]
        at -= 1
    distance[at], nearest[at] = far, number
    return count + 1
