"""The vertical axis of a body of revolution, from points of its surface and their normals.

Knows points only. Normals of such a body meet its axis: seen from above, the line through a point along its
normal goes through one place, whatever the radius. That place is then made better by circles: points at one
height, on one wall, are equally far from it.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from perception.quantiles import median

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


def vertical_axis(points: np.ndarray, normals: np.ndarray) -> np.ndarray | None:
    """Where (2,) [m] the axis meets the plane z = 0; None where points (N, 3) [m] with unit normals (N, 3)
    are not those of a body of revolution about a vertical axis."""
    level = np.hypot(normals[:, 0], normals[:, 1])
    upright = level > UPRIGHT
    if np.count_nonzero(upright) < LEAST_POINTS:
        return None
    place = points[upright, :2].astype(np.float64)
    inward = normals[upright, :2] / level[upright, None].astype(np.float64)
    across = np.stack([-inward[:, 1], inward[:, 0]], 1)
    offset = (across * place).sum(1)
    axis = _meeting_place(across, offset, (level[upright] ** 2).astype(np.float64))
    away = place - axis
    radius = np.hypot(*away.T)
    if median(np.abs(offset - across @ axis) / np.maximum(radius, 1e-3)) > ASTRAY:
        return None
    circle = 2 * np.floor(points[upright, 2] / SLICE).astype(int) + ((inward * away).sum(1) > 0)
    circle -= circle.min()
    axis = _middle_of_circles(place, circle, axis)
    radius = np.hypot(*(place - axis).T)
    limit = max(SPREAD[0], SPREAD[1] * median(radius))
    return axis if median(np.abs(_off(radius, circle))) < limit else None


def _meeting_place(across: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The place (2,) that most of the lines across . p = offset, (N, 2) and (N,), come near to; weight: (N,)
    of each."""
    axis = _solved(across, offset, weight)
    for _ in range(ROUNDS):
        missed = np.abs(offset - (across[:, 0] * axis[0] + across[:, 1] * axis[1]))
        axis = _solved(across, offset, weight / (1 + (missed / max(median(missed), 1e-4)) ** 2))
    return np.array(axis)


@compiled
def _solved(across: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> tuple[float, float]:
    """The place that the lines come nearest to in the mean of squares."""
    xx = xy = yy = x = y = 0.0
    for i in range(len(offset)):
        xx += weight[i] * across[i, 0] * across[i, 0]
        xy += weight[i] * across[i, 0] * across[i, 1]
        yy += weight[i] * across[i, 1] * across[i, 1]
        x += weight[i] * across[i, 0] * offset[i]
        y += weight[i] * across[i, 1] * offset[i]
    return _solution(xx + 1e-9, xy, yy + 1e-9, x, y)


@compiled
def _solution(xx: float, xy: float, yy: float, x: float, y: float) -> tuple[float, float]:
    """What the symmetric matrix turns into (x, y)."""
    determinant = xx * yy - xy * xy
    return (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant


def _middle_of_circles(place: np.ndarray, circle: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The middle (2,), near `axis`, of circles about it through places (N, 2); circle: (N,) whose each is."""
    for _ in range(ROUNDS):
        away = place - axis
        radius = np.hypot(away[:, 0], away[:, 1])
        weight = 1 / (1 + (_off(radius, circle) / 0.002) ** 2)
        axis = axis + _step(away, radius, weight, circle, np.zeros((4, circle.max() + 1)))
    return axis


@compiled
def _step(
    away: np.ndarray, radius: np.ndarray, weight: np.ndarray, circle: np.ndarray, sums: np.ndarray
) -> tuple[float, float]:
    """How far the middle of circles is from where it was looked for; sums: (4, circles) zeros."""
    for i in range(len(radius)):
        least = max(radius[i], 1e-6)
        sums[0, circle[i]] += weight[i] * (away[i, 0] / least)
        sums[1, circle[i]] += weight[i] * (away[i, 1] / least)
        sums[2, circle[i]] += weight[i] * radius[i]
        sums[3, circle[i]] += weight[i]
    xx = xy = yy = x = y = total = 0.0
    for i in range(len(radius)):
        least, count = max(radius[i], 1e-6), max(sums[3, circle[i]], 1e-9)
        u = away[i, 0] / least - sums[0, circle[i]] / count
        v = away[i, 1] / least - sums[1, circle[i]] / count
        r = radius[i] - sums[2, circle[i]] / count
        xx += weight[i] * u * u
        xy += weight[i] * u * v
        yy += weight[i] * v * v
        x += weight[i] * u * r
        y += weight[i] * v * r
        total += weight[i]
    # Short arcs do not say how far away their middle is: there the normals' word stands.
    return _solution(xx + 0.02 * total, xy, yy + 0.02 * total, x, y)


def _off(radius: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """Radii (N,) less the middle one of their circle (N,), numbered from 0 on."""
    count = np.bincount(circle)
    order = np.lexsort((radius, circle))
    # Where there is no circle of a number, that of another stands for it: nobody asks.
    middle = radius[order][np.maximum(np.cumsum(count) - (count + 1) // 2, 0).clip(max=len(radius) - 1)]
    return radius - middle[circle]
