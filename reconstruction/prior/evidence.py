"""What an observation says to the occlusion prior: the adapter between images and arrays of points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from mapping.compiled import compiled
from perception.observation import Observation
from perception.space import Space
from reconstruction.prior.features import BACKGROUND, OTHER, OWN, UNKNOWN, RayEvidence
from reconstruction.prior.occlusion_prior import OcclusionPrior
from reconstruction.prior.protocol import ShapePrior

BORDER_REACH_PX = 48
"""Distances to an object's silhouette are worked out this far from it [px]; beyond, they are that far."""


@dataclass(frozen=True)
class RayLookup:
    """Evidence of one frame: call it with points (N, 3) in the table frame and an object index."""

    observation: Observation
    space: Space

    def __call__(self, points: np.ndarray, index: int) -> RayEvidence:
        sight, border = self.space.look(points), self._border(index)
        kinds = np.full(len(self.observation.objects) + 2, OTHER, np.int8)
        kinds[[index, -2]] = OWN, BACKGROUND  # to the objects, an obstacle is a thing like another one
        # One pixel is z / f metres wide at depth z.
        focal = np.float32(self.observation.camera.K[0, 0])
        seen, inside = _seen_and_inside(
            *sight, self.observation.owner, kinds, self._depths[index], focal, *border
        )
        return RayEvidence(sight.behind, seen, inside)

    @cached_property
    def _depths(self) -> list[np.float32]:
        flat = self.space.depth.reshape(-1)
        return [np.float32(np.median(flat[item.pixels])) for item in self.observation.objects]

    @cached_property
    def _borders(self) -> dict[int, Border]:
        return {}

    def _border(self, index: int) -> Border:
        if index not in self._borders:
            shape = self.observation.depth.shape
            item = self.observation.objects[index]
            self._borders[index] = Border.of(np.concatenate([item.pixels, item.guessed]), *shape)
        return self._borders[index]


class Border(NamedTuple):
    """Distance of pixels to the border of one object's visible region.

    distance: [px], positive inside, of a window of the image whose outermost pixels stand for all beyond it;
    row, column: of the window's corner in the image, which may lie one pixel outside; width: of the image.
    """

    distance: np.ndarray
    row: int
    column: int
    width: int

    @classmethod
    def of(cls, pixels: np.ndarray, height: int, width: int) -> Border:
        """The border of the region of pixels (N,), flat indices in an image of height x width."""
        rows, columns = np.divmod(pixels, width)
        reach = BORDER_REACH_PX
        top, left = max(rows.min() - reach, 0), max(columns.min() - reach, 0)
        bottom, right = min(rows.max() + reach + 1, height), min(columns.max() + reach + 1, width)
        mask = np.zeros((bottom - top, right - left), np.uint8)
        mask[rows - top, columns - left] = 1
        distance = np.full((bottom - top + 2, right - left + 2), -np.float32(reach))
        inner = distance[1:-1, 1:-1]
        np.subtract(
            cv2.distanceTransform(mask, cv2.DIST_L2, 3),
            cv2.distanceTransform(1 - mask, cv2.DIST_L2, 3),
            out=inner,
        )
        np.maximum(inner, -reach, out=inner)
        return cls(distance, int(top) - 1, int(left) - 1, width)


def hidden_labels(
    observation: Observation,
    space: Space,
    points: np.ndarray,
    prior: ShapePrior | None = None,
    only: tuple[int, ...] | None = None,
) -> np.ndarray:
    """What probably fills hidden points: (N, K+1) float32 over {empty, object 1..K}, K observed objects.

    points: (N, 3) [m] in the table frame, behind what is seen. only: objects that the prior that comes with
    the project is asked about, the others are taken to be absent; None: all. Needs a support plane: without
    one nothing says which way is up, and every row gives all classes the same share.
    """
    if observation.support is None:
        count = len(observation.objects) + 1
        return np.full((len(points), count), 1 / count, np.float32)
    visible = [item.outline for item in observation.objects]
    floors = [item.floor for item in observation.objects]
    lookup = observation.memo.setdefault("rays", RayLookup(observation, space))
    if prior is not None:
        return prior.distribution(visible, space.origin, lookup, points, floors)
    own = OcclusionPrior.load()
    return own.distribution(visible, space.origin, lookup, points, floors, observation.memo, only)


@compiled
def _seen_and_inside(
    pixel: np.ndarray,
    depth: np.ndarray,
    behind: np.ndarray,
    owner: np.ndarray,
    kinds: np.ndarray,
    usual: float,
    focal: float,
    distance: np.ndarray,
    first_row: int,
    first_column: int,
    width: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Of points seen as `Sight` says: what their rays see (N,) int8, by the kind of the pixel's owner; and
    how far inside the object's visible region they pass [m] (N,) float32, at the depth `usual` where nothing
    was measured."""
    seen, inside = np.empty(len(pixel), np.int8), np.empty(len(pixel), np.float32)
    for i in range(len(pixel)):
        place = max(pixel[i], 0)
        known = not np.isnan(behind[i])
        seen[i] = kinds[owner[place]] if known else UNKNOWN
        pixels = border_distance(distance, first_row, first_column, width, place)
        inside[i] = pixels * ((depth[i] if known else usual) / focal)
    return seen, inside


@compiled
def border_distance(distance: np.ndarray, first_row: int, first_column: int, width: int, place: int) -> float:
    """Distance [px] of one pixel of the image, a flat index, to the border of an object's visible region; the
    other arguments: the fields of its `Border`."""
    row, column = place // width, place % width
    row = min(max(row - first_row, 0), distance.shape[0] - 1)
    column = min(max(column - first_column, 0), distance.shape[1] - 1)
    return distance[row, column]
