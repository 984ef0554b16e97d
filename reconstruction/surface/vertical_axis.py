"""The vertical axis of a body of revolution, from points of its surface and their normals.

Knows points only. Normals of such a body meet its axis: seen from above, the line through a point along its
normal goes through one place, whatever the radius. That place is then made better by circles: points at one
height, on one wall, are equally far from it.
"""

from __future__ import annotations

import numpy as np

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
    axis = _solved(across, offset, level[upright] ** 2)
    for _ in range(ROUNDS):
        missed = np.abs(offset - across @ axis)
        axis = _solved(
            across, offset, level[upright] ** 2 / (1 + (missed / max(np.median(missed), 1e-4)) ** 2)
        )
    away = place - axis
    radius = np.hypot(*away.T)
    if np.median(np.abs(offset - across @ axis) / np.maximum(radius, 1e-3)) > ASTRAY:
        return None
    circle = 2 * np.floor(points[upright, 2] / SLICE).astype(int) + ((inward * away).sum(1) > 0)
    _, circle = np.unique(circle, return_inverse=True)
    for _ in range(ROUNDS):
        away = place - axis
        radius = np.hypot(*away.T)
        weight = 1 / (1 + (_off(radius, circle) / 0.002) ** 2)
        outward = away / np.maximum(radius, 1e-6)[:, None]
        total = np.maximum(np.bincount(circle, weight), 1e-9)
        parts = [
            column - (np.bincount(circle, weight * column) / total)[circle] for column in (*outward.T, radius)
        ]
        slopes = np.stack(parts[:2], 1)
        normal = (slopes * weight[:, None]).T @ slopes
        # Short arcs do not say how far away their middle is: there the normals' word stands.
        axis = axis + np.linalg.solve(
            normal + 0.02 * weight.sum() * np.eye(2), slopes.T @ (weight * parts[2])
        )
    radius = np.hypot(*(place - axis).T)
    limit = max(SPREAD[0], SPREAD[1] * float(np.median(radius)))
    return axis if np.median(np.abs(_off(radius, circle))) < limit else None


def _solved(across: np.ndarray, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The place (2,) that lines across . p = offset, (N, 2) and (N,), come nearest to."""
    normal = (across * weight[:, None]).T @ across
    return np.linalg.solve(normal + 1e-9 * np.eye(2), across.T @ (weight * offset))


def _off(radius: np.ndarray, circle: np.ndarray) -> np.ndarray:
    """Radii (N,) less the middle one of their circle (N,), numbered from 0 on."""
    order = np.lexsort((radius, circle))
    count = np.bincount(circle)
    middle = radius[order][np.cumsum(count) - (count + 1) // 2]
    return radius - middle[circle]
