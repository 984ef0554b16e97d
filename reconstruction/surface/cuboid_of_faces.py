"""The cuboid whose faces were seen, from points of its surface and their normals.

Cartons, books and bricks: two or three faces are seen, the others are where the seen ones end. Knows points,
normals, and which places are empty; knows nothing of images, maps or lattices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from perception.quantiles import column_quantiles, median, quantiles
from reconstruction.surface.cuboid import Cuboid

ALONG = 0.95
"""Normals within the angle of this cosine belong to a face (18 degrees)."""
ACROSS = 0.3
"""Normals within the angle of this sine are at right angles to a direction (17 degrees)."""
CANDIDATES = 40
"""About so many normals are tried as the direction of a face."""
ROUNDS = 3
"""Each round knows a face's direction better, and with it which points are the face's."""
FEWEST = 20
"""Fewer points say nothing of a direction or an end."""
NARROW = 0.003
"""Points that spread less than this [m] say nothing of a plane; their normals do."""
FACE_SHARE = 0.03
"""A face holds at least this share of the points."""
FACES_SHARE = 0.55
"""At least this share of the normals lies along the faces': where two faces meet they are in between, and a
sensor's noise bends them."""
FLAT, FLAT_SHARE, NOISES = 0.0015, 0.01, 4.0
"""Half of a face's points are no farther than this from its plane [m], or than this share of the longest
side, and these standard deviations of noise."""
FINEST, SLIM = 0.001, 0.08
"""No more than this [m], or this share of the shortest side: a thin round thing is near to some cuboid."""
OFF = 2.0
"""Points so many times as far as that are off the cuboid."""
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
    axes = _axes(points, normals)
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


def _axes(points: np.ndarray, normals: np.ndarray) -> np.ndarray | None:
    """The directions (3, 3) of the faces; None where normals do not lie along three that are at right
    angles."""
    first = _direction(normals, points)
    if first is None:
        return None
    across = np.abs(normals @ first) < ACROSS
    if across.mean() >= FACE_SHARE:
        level = normals[across] - np.outer(normals[across] @ first, first)
        level /= np.linalg.norm(level, axis=1)[:, None]
        second = _direction(level, points[across], first)
        if second is None:
            return None
    else:
        second = _edge(points[np.abs(normals @ first) > ALONG], first)
    axes = np.stack([first, second, np.cross(first, second)])
    return axes if (np.abs(normals @ axes.T).max(1) > ALONG).mean() >= FACES_SHARE else None


def _direction(
    normals: np.ndarray, points: np.ndarray, across: np.ndarray | None = None
) -> np.ndarray | None:
    """The direction (3,) that most normals (N, 3) lie along, at right angles to `across`; from the plane of
    their points (N, 3), for normals are bent near edges."""
    tried = normals[:: 1 + len(normals) // CANDIDATES]
    best = tried[(np.abs(tried @ normals.T) > ALONG).sum(1).argmax()].astype(np.float64)
    for _ in range(ROUNDS):
        own = normals @ best > ALONG
        if np.count_nonzero(own) < FEWEST:
            return None
        found = normals[own].mean(0).astype(np.float64)
        face = points[own].astype(np.float64)
        face -= column_quantiles(face, 0.5)
        off = np.abs(face @ best)
        face = face[off <= OFF * max(median(off), FLAT / 2)]
        if across is not None:
            found -= (found @ across) * across
            face -= np.outer(face @ across, across)
        spread, directions = np.linalg.eigh(face.T @ face / max(len(face), 1))
        # The direction of least spread is the plane's; that of none at all is `across`.
        plane = directions[:, 0 if across is None else 1]
        known = spread[1 if across is None else 2] > NARROW**2
        found /= np.linalg.norm(found)
        if known and abs(plane @ found) > ALONG:
            found = plane * np.sign(plane @ found)
        best = found
    return best


def _edge(face: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The direction (3,) of a side of the smallest rectangle around points (N, 3) of one face."""
    aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    aside /= np.linalg.norm(aside)
    plane = np.stack([aside, np.cross(normal, aside)])
    _, _, degrees = cv2.minAreaRect((face @ plane.T).astype(np.float32))
    turn = np.deg2rad(degrees)
    return np.cos(turn) * plane[0] + np.sin(turn) * plane[1]
