"""Labelled things that carry others: trays, books, boxes. Where does what lies on them end?

Knows visible points of objects in the table frame; knows nothing of images, masks or shapes. Supports without
a label are found in supports.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.observation import ObservedObject
from perception.quantiles import quantiles
from perception.supports import BESIDE, BIN, CELL, HALF_THICKNESS, LEAST_AREA, LEAST_CELLS

TOP_POINTS = 4000
"""Points of an object in which a level top is looked for."""
MIDDLE_POINTS = 400
"""Points of an object whose median is its middle in plan."""
REST_GAP = 0.04
"""What is seen of a thing ends within this height above what it lies on: balls hide where they touch it
[m]."""
FULL = 0.6
"""A top fills this share of its hull around what lies on it: what stands between the arms of a thing does
not."""
INSIDE = 0.015
"""The middle of what lies on a top is this far within its hull in plan [m]: what stands close behind a box is
not."""


def beds(objects: Sequence[ObservedObject]) -> list[float | None]:
    """Height [m] of the level top of another object that each object lies on; None where it lies on none.

    It lies on a top that is seen on several sides of it: in plan its middle lies within the top's hull, and
    what is seen of it ends right above.
    """
    tops: dict[int, tuple[float, np.ndarray] | None] = {}
    found: list[float | None] = []
    for index, item in enumerate(objects):
        middle = np.median(item.points[:: 1 + len(item.points) // MIDDLE_POINTS, :2], axis=0)
        heights = []
        for other, below in enumerate(objects):
            low, high = below.bounds
            # Most things lie beside each other, or on the support: nothing has to be looked for.
            if other == index or item.bounds[0][2] < item.floor + BIN or low[2] > item.bounds[0][2]:
                continue
            if not ((middle > low[:2] + INSIDE) & (middle < high[:2] - INSIDE)).all():
                continue
            if other not in tops:
                tops[other] = _level_top(below.points)
            top = tops[other]
            if top is not None and item.floor < top[0] and _lies_on(item, middle, *top):
                heights.append(top[0])
        found.append(max(heights, default=None))
    return found


def _level_top(points: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Height [m] at which most level surface of an object with points (N, 3) lies, and the plan cells (M, 2)
    [m] of it; None where that is too little to carry anything."""
    points = points[:: 1 + len(points) // TOP_POINTS]
    low, high = points[:, :2].min(0), points[:, :2].max(0)
    if float(np.prod(high - low)) < LEAST_AREA:
        return None
    height = points[:, 2]
    number = np.floor((height - height.min()) / BIN).astype(np.int64)
    x, y = np.floor((points[:, :2] - low) / CELL).astype(np.int64).T
    width = int(y.max()) + 1
    cell = x * width + y
    # Steep sides have many points at a height, but few cells in plan.
    area = np.bincount(np.unique(number * (cell.max() + 1) + cell) // (cell.max() + 1))
    middle = height.min() + BIN * (int(np.convolve(area, np.ones(3), "same").argmax()) + 0.5)
    level = np.abs(height - middle) < HALF_THICKNESS
    plan = np.unique(cell[level])
    if len(plan) * CELL**2 < LEAST_AREA:
        return None
    centres = low + (np.column_stack(np.divmod(plan, width)) + 0.5) * CELL
    return float(np.median(height[level])), centres


def _lies_on(item: ObservedObject, middle: np.ndarray, height: float, cells: np.ndarray) -> bool:
    """Whether an object with its middle (2,) in plan lies on a level top at a height, with plan cells (M, 2)
    [m]."""
    import cv2

    low, high = item.bounds
    ends = float(quantiles(item.points[:, 2], 0.03)[0])
    if low[2] < height - HALF_THICKNESS or ends > height + REST_GAP:
        return False
    near = cells[((cells > low[:2] - BESIDE) & (cells < high[:2] + BESIDE)).all(1)]
    if len(near) < LEAST_CELLS:
        return False
    hull = cv2.convexHull(near.astype(np.float32))
    if len(near) * CELL**2 < FULL * cv2.contourArea(hull):
        return False
    return bool(cv2.pointPolygonTest(hull, (float(middle[0]), float(middle[1])), True) > INSIDE)
