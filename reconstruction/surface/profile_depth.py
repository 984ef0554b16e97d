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
NEAR, BESIDE = 0.006, 0.006
"""The profile is known within this distance across it, and beyond its ends [m]."""
LIP, ENDED = 0.001, 0.0005
"""It ends so far beyond the last measured point [m] where rays passed, and goes on where none did; who is
farther from all of them than the second is beyond it."""
EMPTY, UNKNOWN = np.float32(-0.008), np.float32(0.02)
"""Depths [m] where rays passed, and where nothing is known."""
ALONG = 0.0012
"""Measured points say how deep a place is that are as near to it as the nearest one, or less so by a standard
deviation of so much along the profile [m]: with fewer, noise makes ripples."""
FLOOR = 0.7
"""Normals that point down more than this belong to the inside: a bowl's floor."""
THINNEST = 0.0045
"""A wall of which both sides are known is at least so thick [m]: less falls between a lattice's nodes."""
SLIT = 3
"""Gaps of fewer cells in the table are closed."""
SPECK = 0.1
"""What is apart from the rest of the body in the half plane, and less than this share of the largest piece,
is of stray points: turned about the axis, it would be a ring."""
SLOPE, RAMP = 0.001, 3
"""Beside what is the body's [m] empty space is no emptier than it is far, within so many cells: a lattice
makes steps of a steeper slope."""
ALIKE, ALIKE_SHARE, AMONG = 0.7, 0.1, 2
"""Of the points within so many cells at least this share has a normal within the angle of this cosine, or a
point's own is wrong: at outlines, planes reach round edges."""
STEEP, INNER_SHARE = 0.3, 0.03
"""A wall's normal is level by at least this sine; a body of which more of the points than this share are on
inner walls is a vessel."""
_LEAST_WEIGHT = 2.5
"""Standard deviations beyond which points do not count."""
_RINGS = round(2 * NEAR / CELL)
"""Measured points are looked for within so many cells ..."""
_REACH = int(np.ceil(np.hypot(NEAR, BESIDE) / CELL))
"""... where one is within so many: no place farther away is known."""


def depth_table(profile: np.ndarray, inwards: np.ndarray, low: float, empty: np.ndarray) -> np.ndarray:
    """How far places (R, Z), `CELL` apart in radius from 0 on and in height from `low` [m] on, lie behind the
    surface: float32 [m], EMPTY or so where rays passed, UNKNOWN or so where nothing is known.

    profile: (M, 2) radii and heights of surface points [m]; inwards: (M, 2) their normals, into the body;
    empty: (R, Z) bool, what rays passed.
    """
    profile = np.ascontiguousarray(profile - np.array([0, low]), np.float64)
    inwards = np.ascontiguousarray(inwards, np.float64)
    right = _like_others(profile, inwards, *empty.shape)
    profile, inwards = profile[right], inwards[right]
    outer = (inwards[:, 0] < 0) & (inwards[:, 1] > -FLOOR)
    sides = sorted((outer, ~outer), key=np.count_nonzero)
    (less, less_beyond), (more, more_beyond) = (
        _depth_behind(profile[side], inwards[side], *empty.shape) for side in sides
    )
    # A wall's two sides are known to a millimetre or two, and some walls are no thicker: the side of which
    # more was seen stays where it is.
    both = np.isfinite(less) & np.isfinite(more)
    lacking = np.maximum(THINNEST - np.where(both, less + more, THINNEST), 0)
    depth = np.where(both, np.minimum(less + lacking, more), np.maximum(less, more))
    beyond = np.minimum(less_beyond, more_beyond)
    ends = empty & (beyond > ENDED)
    depth[ends] = np.minimum(depth[ends], LIP - beyond[ends])
    depth = np.where(np.isfinite(depth), depth, np.where(empty, EMPTY, UNKNOWN)).astype(np.float32)
    depth = ndimage.grey_closing(depth, SLIT)
    depth[_specks(depth)] = EMPTY
    return depth


def _specks(depth: np.ndarray) -> np.ndarray:
    """Which places (R, Z) bool of a table (R, Z) are of pieces of the body that are small, and known all
    round."""
    pieces, count = ndimage.label(depth >= 0, np.ones((3, 3)))
    known = depth < UNKNOWN
    sizes = np.bincount(pieces[known], minlength=count + 1)
    small = sizes < SPECK * max(sizes[1:], default=0)
    small[pieces[~known]] = small[0] = False
    return small[pieces]


def is_vessel(inwards: np.ndarray) -> bool:
    """Whether normals (M, 2) of a profile, into the body, show it to be hollow: its inner walls are seen.

    Seen from outside alone, a ball and a bowl upside down are alike; there are more of the first.
    """
    return bool((inwards[:, 0] > STEEP).mean() > INNER_SHARE)


@compiled
def no_steeper(depth: np.ndarray) -> None:
    """Let what is empty (R, Z) [m] beside the body become emptier as distance grows, in place."""
    rows, columns = depth.shape
    for r in range(rows):
        for c in range(columns):
            if depth[r, c] < 0 or depth[r, c] >= UNKNOWN:
                continue
            near = min(depth[r, c], np.float32(SLOPE))
            for i in range(max(r - RAMP, 0), min(r + RAMP + 1, rows)):
                for j in range(max(c - RAMP, 0), min(c + RAMP + 1, columns)):
                    if depth[i, j] < 0:
                        away = np.float32(CELL * np.sqrt((i - r) ** 2 + (j - c) ** 2))
                        # Empty stays empty.
                        depth[i, j] = max(depth[i, j], min(near - away, np.float32(-1e-4)))


@compiled
def _like_others(profile: np.ndarray, inwards: np.ndarray, rows: int, columns: int) -> np.ndarray:
    """Which points (M, 2) have normals (M, 2) as enough of those around have: (M,) bool."""
    starts, order = _by_cell(profile, rows, columns)
    right = np.zeros(len(profile), np.bool_)
    for n in range(len(profile)):
        r, c = int(profile[n, 0] / CELL), int(profile[n, 1] / CELL)
        alike = count = 0
        for i in range(max(r - AMONG, 0), min(r + AMONG + 1, rows)):
            first, last = i * columns + max(c - AMONG, 0), i * columns + min(c + AMONG + 1, columns)
            for m in order[starts[first] : starts[last]]:
                count += 1
                cosine = inwards[n, 0] * inwards[m, 0] + inwards[n, 1] * inwards[m, 1]
                alike += cosine > ALIKE
        right[n] = alike >= ALIKE_SHARE * count
    return right


@compiled
def _depth_behind(
    profile: np.ndarray, inwards: np.ndarray, rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray]:
    """How far places (rows, columns) are behind the profile (M, 2) of one side of a wall [m], the mean of the
    nearest measured points', -inf where that is not known; and how far beyond its ends, inf there."""
    behind, beyond = np.full((rows, columns), -np.inf), np.full((rows, columns), np.inf)
    starts, order = _by_cell(profile, rows, columns)
    for r, c in np.argwhere(_around_points(starts, rows, columns)):
        nearest = np.sqrt(_nearest(r, c, profile, starts, order, rows, columns))
        reach = int(np.sqrt(nearest**2 + (_LEAST_WEIGHT * ALONG) ** 2) / CELL) + 1
        deep = weights = 0.0
        for i in range(max(r - reach, 0), min(r + reach, rows)):
            first, last = i * columns + max(c - reach, 0), i * columns + min(c + reach, columns)
            for n in order[starts[first] : starts[last]]:
                x, y = r * CELL - profile[n, 0], c * CELL - profile[n, 1]
                weight = np.exp((nearest**2 - x * x - y * y) / (2 * ALONG**2))
                weights += weight
                deep += weight * (x * inwards[n, 0] + y * inwards[n, 1])
        if weights == 0:
            continue
        deep /= weights
        aside = np.sqrt(max(nearest**2 - deep**2, 0.0))
        if aside < BESIDE and abs(deep) < NEAR:
            behind[r, c], beyond[r, c] = deep, aside
    return behind, beyond


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
) -> float:
    """The squared distance [m^2] of the place (r, c) from the nearest of points (M, 2), as far as is looked
    for."""
    least = (2 * NEAR) ** 2
    for ring in range(_RINGS):
        for i in range(max(r - ring - 1, 0), min(r + ring + 1, rows)):
            whole = i == r - ring - 1 or i == r + ring
            step = 1 if whole else 2 * ring + 1
            for j in range(c - ring - 1, c + ring + 1, step):
                if j < 0 or j >= columns:
                    continue
                cell = i * columns + j
                for n in order[starts[cell] : starts[cell + 1]]:
                    least = min(least, (r * CELL - points[n, 0]) ** 2 + (c * CELL - points[n, 1]) ** 2)
        if least <= ((ring + 1) * CELL) ** 2:  # all that is no farther than this has been looked at
            break
    return least
