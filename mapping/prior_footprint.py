"""The visible part of an object seen from straight above, height by height, for the occlusion prior.

A box whose top is seen ends where its top ends. The prior's lattice is too coarse to say where that is; the
distance to the border of this plan view is exact to a few millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional as F

from mapping.prior_features import ObjectBox

CELLS = 64
"""Cells along each side of the box."""
LEVELS = 8
"""Heights between the lowest and the highest visible point from which on the plan view is drawn."""
LEAST_SPAN = 0.005
"""The levels span at least this height [m]."""
FOOTPRINT_CHANNELS = 4


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
        cell = ((box.local(visible)[:, :2] + 1) * np.float32(CELLS / 2)).astype(np.int32)
        cell = np.clip(cell, 0, CELLS - 1)
        top = np.full((CELLS, CELLS), -np.inf, np.float32)
        np.maximum.at(top.reshape(-1), cell[:, 0] * CELLS + cell[:, 1], visible[:, 2].astype(np.float32))
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
        height = box.low[2] + (local[:, 2] + 1) / 2 * box.size[2]
        share = (height - box.bottom) / max(box.top - box.bottom, LEAST_SPAN)
        # Half a level up, so that points lower than the query have no say; grid_sample counts y first.
        where = np.stack([local[:, 1], local[:, 0], (2 * (share * LEVELS + 1) / LEVELS - 1)], axis=1)
        volume = torch.from_numpy(self.distance)[None, None]
        grid = torch.from_numpy(where.astype(np.float32))[None, :, None, None]
        distance = F.grid_sample(volume, grid, padding_mode="border", align_corners=False)
        cell = np.clip(((local[:, :2] + 1) * np.float32(CELLS / 2)).astype(np.int32), 0, CELLS - 1)
        above = self.top[cell[:, 0], cell[:, 1]] - height
        return distance[0, 0, :, 0, 0].numpy(), above.astype(np.float32)


def footprint_channels(distance: np.ndarray, above: np.ndarray, side: np.ndarray | float) -> np.ndarray:
    """Feature rows (FOOTPRINT_CHANNELS, N) float32 of what Footprint.at says; side: of the box [m]."""
    known = np.isfinite(above)
    above = np.where(known, above, 0).astype(np.float32)
    return np.stack(
        [
            np.clip(distance / 0.012, -1, 1),
            np.clip(4 * distance / side, -1, 1),
            np.clip(above / 0.015, -1, 1),
            known,
        ]
    ).astype(np.float32)


def _signed_distances(held: np.ndarray) -> np.ndarray:
    """Distance (L, CELLS, CELLS) [cells] to the border of the held cells of each level, positive inside."""
    import cv2

    inward, outward = np.empty(held.shape, np.float32), np.empty(held.shape, np.float32)
    for level, cells in enumerate(held.view(np.uint8)):
        # Surfaces seen at a grazing angle leave single cells without a point.
        mask = cv2.morphologyEx(cells, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        cv2.distanceTransform(mask, cv2.DIST_L2, 3, inward[level])
        cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3, outward[level])
    distance = inward - outward
    distance -= np.copysign(np.float32(0.5), distance)
    return np.clip(distance, -CELLS, CELLS, out=distance)
