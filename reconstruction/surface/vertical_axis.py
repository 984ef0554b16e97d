"""The vertical axis of a body of revolution, from points of its surface and their normals.

Knows points only. Normals of such a body meet its axis: seen from above, the line through a point along its
normal goes through one place, whatever the radius. That place is then made better by circles: points at one
height, on one wall, are equally far from it.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

UPRIGHT = 0.25
"""Normals with less than this of a level part say nothing of where the axis is."""
LEAST_POINTS = 100
"""Fewer points of walls say too little."""
ROUNDS = 6
"""Each round trusts less what the last one left far off: handles, labels."""
ASTRAY = 0.2
"""Half of all normals miss the axis by less than this sine of an angle, or the body is not round."""
SLICE = 0.005
"""Points within this height belong to one circle [m]."""
SPREAD = (0.001, 0.025)
"""Half of the radii of a circle differ from its own by less than this [m], or this share of it."""
CIRCLES_APART = 0.002
"""Points this far off their circle [m] count half."""
SHORT_ARC = 0.02
"""Short arcs do not say how far away their middle is: with this weight the normals' word stands."""


def vertical_axis(points: np.ndarray, normals: np.ndarray) -> np.ndarray | None:
    """Where (2,) [m] the axis meets the plane z = 0; None where points (N, 3) [m] with unit normals (N, 3)
    are not those of a body of revolution about a vertical axis."""
    level = np.hypot(normals[:, 0], normals[:, 1])
    upright = level > UPRIGHT
    if np.count_nonzero(upright) < LEAST_POINTS:
        return None
    place = points[upright].astype(np.float64)
    steep = level[upright].astype(np.float64)
    x, y = _axis(place, normals[upright, :2] / steep[:, None], steep**2)
    return None if np.isnan(x) else np.array([x, y])


@compiled
def _axis(place: np.ndarray, inward: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The same for walls' points (N, 3) with level unit normals (N, 2), NaN where they are not round;
    weight: (N,) of what the normals say."""
    offset = inward[:, 0] * place[:, 1] - inward[:, 1] * place[:, 0]
    axis = _meeting_place(inward, offset, weight)
    missed, circle = np.empty(len(place)), np.empty(len(place), np.int64)
    for i in range(len(place)):
        x, y = place[i, 0] - axis[0], place[i, 1] - axis[1]
        missed[i] = abs(inward[i, 0] * y - inward[i, 1] * x) / max(np.sqrt(x * x + y * y), 1e-3)
        outer = inward[i, 0] * x + inward[i, 1] * y > 0
        circle[i] = 2 * int(np.floor(place[i, 2] / SLICE)) + outer
    if np.median(missed) > ASTRAY:
        return np.nan, np.nan
    circle -= circle.min()
    axis = _middle_of_circles(place, circle, axis)
    radius = _radii(place, axis)
    limit = max(SPREAD[0], SPREAD[1] * np.median(radius))
    return axis if np.median(np.abs(_off(radius, circle))) < limit else (np.nan, np.nan)


@compiled
def _meeting_place(inward: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The place that most of the lines along `inward` (N, 2) come near to, each at an `offset` (N,) from the
    origin; weight: (N,) of each."""
    missed = np.zeros(len(offset))
    least = 1.0
    axis = 0.0, 0.0
    for _ in range(ROUNDS + 1):
        xx = xy = yy = x = y = 0.0
        for i in range(len(offset)):
            across, along = -inward[i, 1], inward[i, 0]
            w = weight[i] / (1 + (missed[i] / least) ** 2)
            xx += w * across * across
            xy += w * across * along
            yy += w * along * along
            x += w * across * offset[i]
            y += w * along * offset[i]
        axis = _solution(xx + 1e-9, xy, yy + 1e-9, x, y)
        missed = np.abs(offset + inward[:, 1] * axis[0] - inward[:, 0] * axis[1])
        least = max(np.median(missed), 1e-4)
    return axis


@compiled
def _solution(xx: float, xy: float, yy: float, x: float, y: float) -> tuple[float, float]:
    """What the symmetric matrix turns into (x, y)."""
    determinant = xx * yy - xy * xy
    return (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant


@compiled
def _middle_of_circles(
    place: np.ndarray, circle: np.ndarray, axis: tuple[float, float]
) -> tuple[float, float]:
    """The middle, near `axis`, of circles about it through places (N, 3); circle: (N,) whose each is."""
    for _ in range(ROUNDS):
        radius = _radii(place, axis)
        weight = 1 / (1 + (_off(radius, circle) / CIRCLES_APART) ** 2)
        step = _step(place, axis, radius, weight, circle)
        axis = axis[0] + step[0], axis[1] + step[1]
    return axis


@compiled
def _radii(place: np.ndarray, axis: tuple[float, float]) -> np.ndarray:
    """How far places (N, 3) are from the axis: (N,)."""
    return np.sqrt((place[:, 0] - axis[0]) ** 2 + (place[:, 1] - axis[1]) ** 2)


@compiled
def _step(
    place: np.ndarray, axis: tuple[float, float], radius: np.ndarray, weight: np.ndarray, circle: np.ndarray
) -> tuple[float, float]:
    """How far the middle of circles is from where it was looked for."""
    sums = np.zeros((4, circle.max() + 1))
    for i in range(len(radius)):
        least = max(radius[i], 1e-6)
        sums[0, circle[i]] += weight[i] * ((place[i, 0] - axis[0]) / least)
        sums[1, circle[i]] += weight[i] * ((place[i, 1] - axis[1]) / least)
        sums[2, circle[i]] += weight[i] * radius[i]
        sums[3, circle[i]] += weight[i]
    xx = xy = yy = x = y = total = 0.0
    for i in range(len(radius)):
        least, count = max(radius[i], 1e-6), max(sums[3, circle[i]], 1e-9)
        u = (place[i, 0] - axis[0]) / least - sums[0, circle[i]] / count
        v = (place[i, 1] - axis[1]) / least - sums[1, circle[i]] / count
        r = radius[i] - sums[2, circle[i]] / count
        xx += weight[i] * u * u
        xy += weight[i] * u * v
        yy += weight[i] * v * v
        x += weight[i] * u * r
        y += weight[i] * v * r
        total += weight[i]
    return _solution(xx + SHORT_ARC * total, xy, yy + SHORT_ARC * total, x, y)


@compiled
def _off(radius: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """Radii (N,) less the middle one of their circle (N,), numbered from 0 on."""
    ends = np.zeros(circle.max() + 2, np.int64)
    for c in circle:
        ends[c + 1] += 1
    ends = np.cumsum(ends)
    free, sorted_radii = ends.copy(), np.empty(len(radius))
    for i in range(len(radius)):
        sorted_radii[free[circle[i]]] = radius[i]
        free[circle[i]] += 1
    middle = np.zeros(len(ends) - 1)
    for c in range(len(middle)):
        own = sorted_radii[ends[c] : ends[c + 1]]
        if len(own):
            own.sort()
            middle[c] = own[len(own) // 2]
    return radius - middle[circle]
