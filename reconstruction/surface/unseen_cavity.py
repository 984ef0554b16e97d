"""What is inside of a body of revolution of which only the outside was seen: more of it, or a cavity.

Knows a profile's points and normals and its table of depths; knows nothing of images, axes or maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.compiled import compiled
from reconstruction.surface.profile_depth import CELL, THINNEST, UNKNOWN

DEEP = np.float32(0.0025)
"""Depth of what is taken to be inside, or to be empty [m]: no more, for nobody saw it, and who asks how sure
it is goes by the depth."""
END, MIDDLE = 0.15, 0.1
"""An end is this share of the height; the middle lies no farther than this share from half of it."""
HIGH = 0.02
"""What is lower [m] shows no widening."""
WIDER = 1.06
"""At its opening a vessel is this much wider than half way, and no narrower there than at its other end."""
WIDE = 0.025
"""A narrower end [m] is no opening: handles and cones are full."""
PAST, RIM, PASSED_SHARE = (0.01, 0.02), (0.9, 1.1), 0.6
"""It ends where rays passed through this share of the places so far past it [m], at these shares of the
radius: within it the body itself hides them."""
OUTER = 90
"""Percentile of radii that is taken for the outside."""
ALONG, COVERED = 0.7, 0.8
"""A normal is along the axis by this cosine; such ones within this share of the radius are a lid ..."""
LID_SHARE = 0.02
"""... where more than this share of the end's points are such."""
_WALL = np.float32(THINNEST)


@dataclass(frozen=True)
class Cavity:
    """Which way a cavity opens, and the height of its closed bottom [m], None where that end is not known."""

    upper: bool
    bottom: float | None


def cavity(profile: np.ndarray, inwards: np.ndarray, low: float, empty: np.ndarray) -> Cavity | None:
    """The cavity of a body that widens to one of its ends, ends there, and is not seen to be closed: a cup or
    bowl upside down. Balls, cans and bottles have none; of a ball half hidden nobody knows where it ends.

    profile: (M, 2) radii and heights of points on its outside [m]; inwards: (M, 2) normals, into the body;
    empty: (R, Z) bool, what rays passed, `CELL` apart in radius from 0 on and in height from `low` [m] on.
    """
    bottom, top = np.percentile(profile[:, 1], [1, 99])
    if top - bottom < HIGH:
        return None
    level = (profile[:, 1] - bottom) / (top - bottom)
    ends = level < END, level > 1 - END
    bands = ends[0], np.abs(level - 0.5) < MIDDLE, ends[1]
    if min(np.count_nonzero(band) for band in bands) == 0:
        return None
    below, half, above = (float(np.percentile(profile[band, 0], OUTER)) for band in bands)
    upper = above > below
    wide, narrow = (above, below) if upper else (below, above)
    if wide < max(WIDE, WIDER * half) or half < narrow:
        return None

    def ended(radius: float, up: bool) -> bool:
        beyond = [top + reach if up else bottom - reach for reach in PAST]
        first, last = sorted(min(max(int((z - low) / CELL), 0), empty.shape[1] - 1) for z in beyond)
        rim = [int(share * radius / CELL) for share in RIM]
        return bool(empty[rim[0] : rim[1] + 1, first : last + 1].mean() > PASSED_SHARE)

    end = ends[int(upper)]
    away = -inwards[end, 1] if upper else inwards[end, 1]
    lid = (away > ALONG) & (profile[end, 0] < COVERED * wide)
    if not ended(wide, upper) or lid.mean() > LID_SHARE:
        return None
    return Cavity(upper, float(bottom if upper else top) if ended(narrow, not upper) else None)


def fill(depth: np.ndarray) -> None:
    """Take what a table (R, Z) does not know nearer to the axis than the body's surface for its inside."""
    _put_inside(depth, 0, depth.shape[1])


def hollow_out(depth: np.ndarray, low: float, cavity: Cavity) -> None:
    """The same, but take it for a cavity behind a thin wall. low: height of the table's first row [m]."""
    first, last = 0, 0
    if cavity.bottom is not None:
        inner = cavity.bottom + (THINNEST if cavity.upper else -THINNEST)
        first, last = sorted(round((height - low) / CELL) for height in (cavity.bottom, inner))
    _put_inside(depth, first, last)


@compiled
def _put_inside(depth: np.ndarray, first: int, last: int) -> None:
    """Fill the columns of a table from `first` to before `last`, and hollow out the others."""
    rows, columns = depth.shape
    for c in range(columns):
        within, full = False, first <= c < last
        for r in range(rows - 1, -1, -1):
            if depth[r, c] < UNKNOWN:
                within = depth[r, c] >= 0
                if not full:
                    depth[r, c] = min(depth[r, c], max(_WALL - depth[r, c], -DEEP))
            elif within:
                depth[r, c] = DEEP if full else -DEEP
