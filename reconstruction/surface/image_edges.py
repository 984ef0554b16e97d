"""Where an object's image ends, or jumps to a farther part of it, pixel by pixel.

Knows masks and depth images; knows nothing of points, planes or maps.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.depth_edges import depth_jump

BORDER = 6
"""Pixels around an object in which the distance to its silhouette is worked out."""
SAME_DEPTH = 0.002
"""Beside an object's edge, a surface this much farther away is beyond the edge [m]; within an object, the
jump must be one that no slanted surface explains."""
USUAL = PerceptionConfig()
"""What counts as a jump of depth."""


def box_of(pixels: np.ndarray, width: int) -> tuple[slice, slice]:
    """Rows and columns of flat indices (N,) in an image of some width."""
    rows = pixels // width
    columns = pixels - rows * width
    return slice(int(rows.min()), int(rows.max()) + 1), slice(int(columns.min()), int(columns.max()) + 1)


def edge_pixels(own: np.ndarray, depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (h, w) bool on the near side of an edge of an object's image own (h, w), and on its far side.

    What was not measured is on the near side, too, where something else was measured beside it, and that is
    on the far one: nobody knows whether rays passed in between.
    """
    depth = np.ascontiguousarray(depth, np.float32)
    return _edge_pixels(own, depth, depth_jump(depth, camera, USUAL))


@compiled
def _edge_pixels(own: np.ndarray, depth: np.ndarray, jump: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    height, width = own.shape
    near, far = np.zeros(own.shape, np.bool_), np.zeros(own.shape, np.bool_)
    for i in range(height):
        for j in range(width):
            if own[i, j]:
                for row in range(max(i - 1, 0), min(i + 2, height)):
                    for column in range(max(j - 1, 0), min(j + 2, width)):
                        limit = jump[i, j] if own[row, column] else np.float32(SAME_DEPTH)
                        if depth[row, column] - depth[i, j] > limit:
                            near[i, j] = far[row, column] = True
            elif np.isnan(depth[i, j]):
                for row in range(max(i - 1, 0), min(i + 2, height)):
                    for column in range(max(j - 1, 0), min(j + 2, width)):
                        if not own[row, column] and not np.isnan(depth[row, column]):
                            near[i, j] = far[row, column] = True
    return near, far


def nearest_of(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each place (h, w) the nearest of some pixels (h, w) bool, as its number from 1 on, 0 where none is
    within BORDER; how far it is (h, w) float32 [px]; and where these pixels are (E,), as flat indices."""
    import cv2

    if not pixels.any():
        far = np.full(pixels.shape, BORDER + 1, np.float32)
        return np.zeros(pixels.shape, np.int32), far, np.empty(0, np.int64)
    distance, number = cv2.distanceTransformWithLabels(
        (~pixels).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number[distance > BORDER] = 0
    # OpenCV numbers the pixels; which number is whose stands at the pixels themselves.
    at = np.flatnonzero(pixels)
    place = np.empty(len(at), np.int64)
    place[number.reshape(-1)[at] - 1] = at
    return number, distance, place
