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
    if np.median(np.abs(offset - across @ axis) / np.maximum(radius, 1e-3)) > ASTRAY:
        return None
    circle = 2 * np.floor(points[upright, 2] / SLICE).astype(int) + ((inward * away).sum(1) > 0)
    circle -= circle.min()
    axis = _middle_of_circles(place, circle, axis)
    radius = np.hypot(*(place - axis).T)
    limit = max(SPREAD[0], SPREAD[1] * float(np.median(radius)))
    return axis if np.median(np.abs(_off(radius, circle))) < limit else None


@compiled
def _meeting_place(across: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The place (2,) that most of the lines across . p = offset, (N, 2) and (N,), come near to; weight: (N,)
    of each."""
    axis = _solved(across, offset, weight)
    for _ in range(ROUNDS):
        missed = np.abs(offset - (across[:, 0] * axis[0] + across[:, 1] * axis[1]))
        trusted = weight / (1 + (missed / max(np.median(missed), 1e-4)) ** 2)
        axis = _solved(across, offset, trusted)
    return axis


@compiled
def _solved(across: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The place (2,) that the lines come nearest to in the mean of squares."""
    xx = xy = yy = x = y = 0.0
    for i in range(len(offset)):
        xx += weight[i] * across[i, 0] * across[i, 0]
        xy += weight[i] * across[i, 0] * across[i, 1]
        yy += weight[i] * across[i, 1] * across[i, 1]
        x += weight[i] * across[i, 0] * offset[i]
        y += weight[i] * across[i, 1] * offset[i]
    return _solution(xx + 1e-9, xy, yy + 1e-9, x, y)


@compiled
def _solution(xx: float, xy: float, yy: float, x: float, y: float) -> np.ndarray:
    """The (2,) that the symmetric matrix turns into (x, y)."""
    return np.array([yy * x - xy * y, xx * y - xy * x]) / (xx * yy - xy * xy)


@compiled
def _middle_of_circles(place: np.ndarray, circle: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """The middle (2,), near `axis`, of circles about it through places (N, 2); circle: (N,) whose each is."""
    for _ in range(ROUNDS):
        away = place - axis
        radius = np.hypot(away[:, 0], away[:, 1])
        weight = 1 / (1 + (_off(radius, circle) / 0.002) ** 2)
        total = np.full(circle.max() + 1, 1e-9)
        means = np.zeros((len(total), 3))
        values = np.empty((len(place), 3))
        for i in range(len(place)):
            values[i] = away[i, 0] / max(radius[i], 1e-6), away[i, 1] / max(radius[i], 1e-6), radius[i]
            total[circle[i]] += weight[i]
            means[circle[i]] += weight[i] * values[i]
        xx = xy = yy = x = y = 0.0
        for i in range(len(place)):
            u, v, r = values[i] - means[circle[i]] / total[circle[i]]
            xx += weight[i] * u * u
            xy += weight[i] * u * v
            yy += weight[i] * v * v
            x += weight[i] * u * r
            y += weight[i] * v * r
        # Short arcs do not say how far away their middle is: there the normals' word stands.
        least = 0.02 * weight.sum()
        axis = axis + _solution(xx + least, xy, yy + least, x, y)
    return axis


@compiled
def _off(radius: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """Radii (N,) less the middle one of their circle (N,), numbered from 0 on."""
    ends = np.cumsum(np.bincount(circle))
    places, sorted_radii = ends.copy(), np.empty_like(radius)
    for i in range(len(radius)):
        places[circle[i]] -= 1
        sorted_radii[places[circle[i]]] = radius[i]
    middle = np.zeros(len(ends))
    for k in range(len(ends)):
        if places[k] < ends[k]:
            middle[k] = np.sort(sorted_radii[places[k] : ends[k]])[(ends[k] - places[k]) // 2]
    return radius - middle[circle]
