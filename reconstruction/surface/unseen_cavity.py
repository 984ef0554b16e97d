"""What is inside of a body of revolution of which only the outside was seen: more of it, or a cavity.

Knows a profile's points and normals and its table of depths; knows nothing of images, axes or maps.
"""

from __future__ import annotations

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


def opens(profile: np.ndarray, inwards: np.ndarray, low: float, empty: np.ndarray) -> bool:
    """Whether a body widens to one of its ends, ends there, and is not seen to be closed: a cup or bowl
    upside down. Balls, cans and bottles do not; of a ball half hidden nobody knows where it ends.

    profile: (M, 2) radii and heights of points on its outside [m]; inwards: (M, 2) normals, into the body;
    empty: (R, Z) bool, what rays passed, `CELL` apart in radius from 0 on and in height from `low` [m] on.
    """
    bottom, top = np.percentile(profile[:, 1], [1, 99])
    if top - bottom < HIGH:
        return False
    level = (profile[:, 1] - bottom) / (top - bottom)
    ends = level < END, level > 1 - END
    bands = ends[0], np.abs(level - 0.5) < MIDDLE, ends[1]
    if min(np.count_nonzero(band) for band in bands) == 0:
        return False
    below, half, above = (float(np.percentile(profile[band, 0], OUTER)) for band in bands)
    upper = above > below
    wide, narrow = (above, below) if upper else (below, above)
    if wide < max(WIDE, WIDER * half) or half < narrow:
        return False
    beyond = [top + reach if upper else bottom - reach for reach in PAST]
    first, last = sorted(min(max(int((height - low) / CELL), 0), empty.shape[1] - 1) for height in beyond)
    rim = [int(share * wide / CELL) for share in RIM]
    if not empty[rim[0] : rim[1] + 1, first : last + 1].mean() > PASSED_SHARE:
        return False
    end = ends[int(upper)]
    away = -inwards[end, 1] if upper else inwards[end, 1]
    lid = (away > ALONG) & (profile[end, 0] < COVERED * wide)
    return bool(lid.mean() <= LID_SHARE)


@compiled
def fill(depth: np.ndarray) -> None:
    """Take what a table (R, Z) does not know nearer to the axis than the body's surface for its inside."""
    rows, columns = depth.shape
    for c in range(columns):
        within = False
        for r in range(rows - 1, -1, -1):
            if depth[r, c] < UNKNOWN:
                within = depth[r, c] >= 0
            elif within:
                depth[r, c] = DEEP


@compiled
def hollow_out(depth: np.ndarray) -> None:
    """The same, but take it for a cavity behind a thin wall."""
    rows, columns = depth.shape
    for c in range(columns):
        within = False
        for r in range(rows - 1, -1, -1):
            if depth[r, c] < UNKNOWN:
                within = depth[r, c] >= 0
                depth[r, c] = min(depth[r, c], max(_WALL - depth[r, c], -DEEP))
            elif within:
                depth[r, c] = -DEEP
