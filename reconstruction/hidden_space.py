"""What an observation says to the occlusion prior: the adapter between images and arrays of points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from mapping.occlusion_prior import OcclusionPrior
from mapping.prior_features import BACKGROUND, OTHER, OWN, UNKNOWN, RayEvidence
from perception.observation import Observation
from perception.space import Space

BORDER_REACH_PX = 48
"""Distances to an object's silhouette are worked out this far from it [px]; beyond, they are that far."""


@dataclass(frozen=True)
class RayLookup:
    """Evidence of one frame: call it with points (N, 3) in the table frame and an object index."""

    observation: Observation
    space: Space

    def __call__(self, points: np.ndarray, index: int) -> RayEvidence:
        pixel = self.space.pixel_of(points)
        behind = self.space.depth_behind(points)
        known = np.isfinite(behind)
        pixel = np.where(pixel < 0, 0, pixel)
        owner = self._owner.take(pixel)
        seen = np.where(owner == index, OWN, np.where(owner < 0, BACKGROUND, OTHER)).astype(np.int8)
        seen[~known] = UNKNOWN
        border = self._border(index).take(pixel)
        # One pixel is z / f metres wide at depth z.
        depth = self.observation.depth.reshape(-1).take(pixel) + behind
        depth[~known] = self._depths[index]
        border = border * (depth / np.float32(self.observation.camera.K[0, 0]))
        return RayEvidence(behind, seen, border)

    @cached_property
    def _owner(self) -> np.ndarray:
        """Object index seen at each pixel (H W,) int16, -1 for none."""
        owner = np.full(self.observation.depth.size, -1, np.int16)
        for index, item in enumerate(self.observation.objects):
            owner[item.pixels] = index
        return owner

    @cached_property
    def _depths(self) -> list[np.float32]:
        flat = self.observation.depth.reshape(-1)
        return [np.float32(np.median(flat[item.pixels])) for item in self.observation.objects]

    @cached_property
    def _borders(self) -> dict[int, np.ndarray]:
        return {}

    def _border(self, index: int) -> np.ndarray:
        """Distance [px] of each pixel (H W,) to the border of an object's visible region, positive inside."""
        if index not in self._borders:
            self._borders[index] = self._distances(index).reshape(-1)
        return self._borders[index]

    def _distances(self, index: int) -> np.ndarray:
        height, width = self.observation.depth.shape
        rows, columns = np.divmod(self.observation.objects[index].pixels, width)
        reach = BORDER_REACH_PX
        top, left = max(rows.min() - reach, 0), max(columns.min() - reach, 0)
        bottom, right = min(rows.max() + reach + 1, height), min(columns.max() + reach + 1, width)
        mask = np.zeros((bottom - top, right - left), np.uint8)
        mask[rows - top, columns - left] = 1
        result = np.full((height, width), -np.float32(reach))
        outward = cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3)
        inward = cv2.distanceTransform(mask, cv2.DIST_L2, 3)
        result[top:bottom, left:right] = np.maximum(inward - outward, -reach)
        return result


def hidden_labels(
    observation: Observation, space: Space, points: np.ndarray, prior: OcclusionPrior | None = None
) -> np.ndarray:
    """What probably fills hidden points: (N, K+1) float32 over {empty, object 1..K}, K observed objects.

    points: (N, 3) [m] in the table frame, behind what is seen. Needs a support plane: without one nothing
    says which way is up, and every row gives all classes the same share.
    """
    if observation.support is None:
        count = len(observation.objects) + 1
        return np.full((len(points), count), 1 / count, np.float32)
    prior = prior or OcclusionPrior.load()
    visible = [item.points for item in observation.objects]
    return prior.distribution(visible, space.origin, RayLookup(observation, space), points)
