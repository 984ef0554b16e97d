"""The cuboid whose faces were seen, from points of its surface and their normals.

Cartons, books and bricks: two or three faces are seen, the others are where the seen ones end. Knows points,
normals, and which places are empty; knows nothing of images, maps or lattices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from perception.quantiles import median, quantiles
from reconstruction.surface.cuboid import Cuboid
from reconstruction.surface.face_directions import (
    ACROSS,
    ALONG,
    FACE_SHARE,
    FEWEST,
    FLAT,
    OFF,
    face_directions,
)

FLAT_SHARE, NOISES = 0.01, 4.0
"""Half of a face's points are no farther from its plane than FLAT, or than this share of the longest side,
and these standard deviations of noise."""
FINEST, SLIM = 0.001, 0.08
"""No more than this [m], or this share of the shortest side: a thin round thing is near to some cuboid."""
OFF_SHARE = 0.04
"""No more than this share of the points is off it."""
LEAST_SIDE = 0.008
"""A side shorter than this [m] was not seen well enough."""
OUTERMOST = 0.01
"""Where a side is not seen, this share of the points on the faces beside it may be beyond it."""
END = 0.01
"""The points so near to an end [m] tell where it is: ..."""
BEYOND = np.concatenate([np.arange(-0.003, 0.0105, 0.0005), np.arange(0.012, 0.041, 0.004)])
"""... places so far beyond it [m] ..."""
SUNK = 0.0007
"""... so far below the surface that they are on [m], for what was measured has noise, ..."""
SURELY, BEYOND_SHARE = 0.005, 0.25
"""... tell it where they begin to be empty. Farther away than this [m] at least this share of them is: others
may hide the rest, and a side is straight."""
SHADOW = 0.01
"""Where what is empty begins farther away than this [m], a shadow without depth lies between, and the cuboid
ends with what was measured of it."""
SEEN, HIDDEN, CARRIED = 0, 1, 2
"""An end: rays passed beyond it; something hides it; something begins there that may carry the object."""
MOST_OPEN = 2
"""Of a cuboid of which two faces are seen, or three, no more ends are out of sight."""
UPRIGHT = 0.985
"""A side that looks down within the angle of this cosine stands on the floor (10 degrees)."""
INSET, INSET_SHARE = 0.004, 0.025
"""Places within it are this far from its faces [m], or this share of its longest side: so near to its edges
that a can is none."""
EMPTY_SHARE = 0.03
"""No more than this share of them may be empty."""


class Told(NamedTuple):
    """What is known of N places: empty: (N,) bool, nothing is there; carrying: (N,) bool, right before them
    something else was seen, that may carry the object rather than hide it."""

    empty: np.ndarray
    carrying: np.ndarray


Look = Callable[[np.ndarray], Told]
"""look(points (N, 3) float32 [m]): what is known of them."""


def cuboid_of(
    points: np.ndarray, normals: np.ndarray, look: Look, floor: float | None, noise: float = 0.0
) -> Cuboid | None:
    """The cuboid that points (N, 3) float32 [m] with outward unit normals (N, 3) lie on.

    None where they lie on none, or where too little is known of its sides; an end that something hides may be
    open. floor: height of what it may stand on [m], None where unknown. noise: standard deviation of the
    points [m].
    """
    axes = face_directions(points, normals)
    if axes is None:
        return None
    at, facing = points @ axes.T, normals @ axes.T
    tolerance = _tolerance(float(np.ptp(at, axis=0).max()), noise)
    ends, faces, open, stands = np.empty((2, 3)), *np.zeros((3, 2, 3), bool)
    for side, axis in np.ndindex(ends.shape):
        sign = 2 * side - 1
        own = sign * facing[:, axis] > ALONG
        if own.mean() >= FACE_SHARE:
            faces[side, axis], ends[side, axis] = True, median(at[own, axis])
            if median(np.abs(at[own, axis] - ends[side, axis])) > tolerance:
                return None  # several faces one behind another
            continue
        beside = np.abs(facing[:, axis]) < ACROSS
        end, known = _end(points[beside], normals[beside], sign * axes[axis], look)
        ends[side, axis] = sign * (np.max(sign * at[:, axis]) if np.isnan(end) else end)
        stands[side, axis] = known == HIDDEN and floor is not None and -sign * axes[axis, 2] > UPRIGHT
        open[side, axis] = known != SEEN and not stands[side, axis]
    if not _enough(faces, open):
        return None
    for side, axis in np.argwhere(stands):  # one at most; its lowest corner is on the floor
        others = np.delete(np.arange(3), axis)
        lowest = (ends[:, others] * axes[others, 2]).min(0).sum()
        ends[side, axis] = (floor - lowest) / axes[axis, 2]
    low, high = ends
    found = Cuboid(axes, low, high, open)
    sides = (found.high - found.low)[~open.any(0)]
    if sides.min() < LEAST_SIDE or off_faces(found, points, noise).mean() > OFF_SHARE:
        return None
    margin = max(INSET, INSET_SHARE * float(sides.max())) + NOISES * noise
    return None if look(found.inner(margin)).empty.mean() > EMPTY_SHARE else found


def _enough(faces: np.ndarray, open: np.ndarray) -> bool:
    """Whether enough is known of sides (2, 3): faces that were seen, and ends that were not."""
    axes_seen = faces.any(0)
    if axes_seen.sum() > 1:
        return bool(open.sum() <= MOST_OPEN)
    # A single face says how the rest is turned by its outline alone: that has to be whole.
    return not open[:, ~axes_seen].any()


def off_faces(cuboid: Cuboid, points: np.ndarray, noise: float = 0.0) -> np.ndarray:
    """Which of points (N, 3) seen of an object are not on a cuboid's faces: (N,) bool; noise: of them [m]."""
    sides = (cuboid.high - cuboid.low)[~cuboid.open.any(0)]
    tolerance = min(_tolerance(float(sides.max()), noise), max(FINEST, SLIM * float(sides.min())))
    return np.asarray(np.abs(cuboid.depth(points)) > OFF * tolerance)


def _tolerance(longest: float, noise: float) -> float:
    """How far the points of a face lie from its plane [m]; longest: side of the cuboid."""
    return max(FLAT, FLAT_SHARE * longest) + NOISES * noise


def _end(points: np.ndarray, normals: np.ndarray, outward: np.ndarray, look: Look) -> tuple[float, int]:
    """Where [m] along a direction `outward` (3,) the faces end that points (N, 3) with normals (N, 3) lie on,
    as far as they were seen, NaN where none was; and whether they do end there: SEEN, HIDDEN, or CARRIED."""
    if len(points) < FEWEST:
        return np.nan, HIDDEN
    place = points @ outward
    end = float(quantiles(place, 1 - OUTERMOST)[0])
    last = place > end - END
    sunk = points[last] - SUNK * normals[last] + (end - place[last])[:, None] * outward
    places = sunk + BEYOND[:, None, None] * outward  # (S, M, 3)
    told = look(places.reshape(-1, 3).astype(np.float32))
    empty, carrying = (share.reshape(len(BEYOND), -1).mean(1) for share in told)
    most = empty[BEYOND > SURELY].max()
    if most >= BEYOND_SHARE:
        step = float(BEYOND[np.argmax(empty > most / 2)])
        return end + (step if step < SHADOW else 0.0), SEEN
    return end, CARRIED if carrying[BEYOND > SURELY].mean() > BEYOND_SHARE else HIDDEN
