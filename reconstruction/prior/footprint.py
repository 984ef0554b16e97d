"""The visible part of an object seen from straight above, height by height, for the occlusion prior.

A box whose top is seen ends where its top ends. The prior's lattice is too coarse to say where that is; the
distance to the border of this plan view is exact to a few millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.prior.features import ObjectBox
from reconstruction.prior.trilinear import corners

CELLS = 64
"""Cells along each side of the box."""
LEVELS = 8
"""Heights between the lowest and the highest visible point from which on the plan view is drawn."""
LEAST_SPAN = 0.005
"""The levels span at least this height [m]."""
FOOTPRINT_NAMES = ("plan_distance_12mm", "plan_distance_over_side", "top_over_point_15mm", "top_known")
FOOTPRINT_CHANNELS = len(FOOTPRINT_NAMES)


@dataclass(frozen=True)
class Footprint:
    """Plan views of the visible points of one object.

    distance: (LEVELS, CELLS, CELLS) float32, distance [m] to the border of the cells that hold points from
    the level upwards, positive inside; top: (CELLS, CELLS) float32 height [m] of the highest point of each
    cell, NaN where there is none. Both counted along the box's x, then y.
    """

    distance: np.ndarray
    top: np.ndarray

    @classmethod
    def of(cls, box: ObjectBox, visible: np.ndarray) -> Footprint:
        """The plan views of visible points (M, 3) of the table frame."""
        x, y = _cells(box.local(visible))
        top = np.full((CELLS, CELLS), -np.inf, np.float32)
        np.maximum.at(top.reshape(-1), x * CELLS + y, visible[:, 2].astype(np.float32))
        span = max(box.top - box.bottom, LEAST_SPAN)
        levels = (box.bottom + span * np.arange(LEVELS) / LEVELS).astype(np.float32)
        distance = _signed_distances(top >= levels[:, None, None])
        distance *= np.float32(box.size[0] / CELLS)
        return cls(distance, np.where(np.isfinite(top), top, np.float32(np.nan)))

    def at(self, box: ObjectBox, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """At points (N, 3) in box coordinates: distance (N,) [m] to the border of what is seen at their
        height or above, and height (N,) [m] of the highest seen point over or under them, from them, NaN
        where there is none. Both float32.
        """
        local = np.asarray(local, np.float32)
        x, y, z = local.T
        low, bottom = np.float32(box.low[2]), np.float32(box.bottom)
        height = low + (z + 1) * np.float32(box.size[2] / 2)
        share = (height - bottom) / np.float32(max(box.top - box.bottom, LEAST_SPAN))
        # Half a level up, so that points lower than the query have no say.
        index, weight = corners(np.stack([2 * share + (2 / LEVELS - 1), x, y]), self.distance.shape)
        distance = (self.distance.take(index) * weight).sum(0)
        x, y = _cells(local)
        return distance, self.top.take(x * CELLS + y) - height


def _cells(local: np.ndarray) -> np.ndarray:
    """(2, N) int32: cells along x and y of points (N, 3) in box coordinates."""
    cell = ((local.T[:2] + 1) * np.float32(CELLS / 2)).astype(np.int32)
    return np.clip(cell, 0, CELLS - 1, out=cell)


def footprint_channels(distance: np.ndarray, above: np.ndarray, side: np.ndarray | float) -> np.ndarray:
    """Feature rows (FOOTPRINT_CHANNELS, N) float32 of what Footprint.at says; side: of the box [m]."""
    known = np.isfinite(above)
    rows = np.empty((FOOTPRINT_CHANNELS, len(distance)), np.float32)
    np.divide(distance, 0.012, out=rows[0])
    np.divide(4 * distance, side, out=rows[1])
    np.divide(np.where(known, above, 0), 0.015, out=rows[2])
    np.clip(rows[:3], -1, 1, out=rows[:3])
    rows[3] = known
    return rows


def _signed_distances(held: np.ndarray) -> np.ndarray:
    """Distance (L, CELLS, CELLS) [cells] to the border of the held cells of each level, positive inside."""
    import cv2

    # Surfaces seen at a grazing angle leave single cells without a point. The levels are closed as channels
    # of one picture.
    picture = np.moveaxis(held, 0, 2).astype(np.uint8)
    closed = cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    inner = np.ascontiguousarray(np.moveaxis(closed, 2, 0))
    outer = 1 - inner
    inward, outward = np.empty(held.shape, np.float32), np.empty(held.shape, np.float32)
    for level in range(len(held)):
        cv2.distanceTransform(inner[level], cv2.DIST_L2, 3, inward[level])
        cv2.distanceTransform(outer[level], cv2.DIST_L2, 3, outward[level])
    distance = np.subtract(inward, outward, out=inward)
    distance -= np.copysign(np.float32(0.5), distance)
    return np.clip(distance, -CELLS, CELLS, out=distance)
