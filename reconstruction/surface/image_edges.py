"""Where an object's image ends, or jumps to a farther part of it, pixel by pixel.

Knows masks and depth images; knows nothing of points, planes or maps.
"""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.depth_edges import depth_jump

BORDER = 6
"""Pixels around an object in which the distance to its silhouette is worked out."""
SAME_DEPTH = 0.002
"""Beside an object's edge, a surface this much farther away is beyond the edge [m]; within an object, the
jump must be one that no slanted surface explains."""


def box_of(pixels: np.ndarray, width: int) -> tuple[slice, slice]:
    """Rows and columns of flat indices (N,) in an image of some width."""
    rows = pixels // width
    columns = pixels - rows * width
    return slice(int(rows.min()), int(rows.max()) + 1), slice(int(columns.min()), int(columns.max()) + 1)


def edge_pixels(own: np.ndarray, depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (h, w) bool on the near side of an edge of an object's image own (h, w), and on its far side."""
    # A frame of pixels without depth: on the flat image a step to a neighbour is one shift.
    framed = np.pad(depth, 1, constant_values=np.nan)
    shape, depth, own = framed.shape, framed.reshape(-1), np.pad(own, 1).reshape(-1)
    jump = depth_jump(depth, camera, PerceptionConfig())
    near, far = np.zeros_like(own), np.zeros_like(own)
    for step in (1, shape[1], shape[1] + 1, shape[1] - 1):
        ahead, back = slice(step, None), slice(None, -step)
        for one, other in ((back, ahead), (ahead, back)):
            limit = np.where(own[other], jump[one], np.float32(SAME_DEPTH))
            with np.errstate(invalid="ignore"):
                edge = own[one] & (depth[other] - depth[one] > limit)
            near[one] |= edge
            far[other] |= edge
    inner = (slice(1, -1), slice(1, -1))
    return near.reshape(shape)[inner], far.reshape(shape)[inner]


def nearest_of(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each place (h, w) the nearest of some pixels (h, w) bool, as its number from 1 on, 0 where none is
    within BORDER; and where these pixels are (E,), as flat indices."""
    import cv2

    if not pixels.any():
        return np.zeros(pixels.shape, np.int32), np.empty(0, np.int64)
    distance, number = cv2.distanceTransformWithLabels(
        (~pixels).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    number[distance > BORDER] = 0
    # OpenCV numbers the pixels; which number is whose stands at the pixels themselves.
    at = np.flatnonzero(pixels)
    place = np.empty(len(at), np.int64)
    place[number.reshape(-1)[at] - 1] = at
    return number, place
