"""Colour and labels brought to the depth camera where the two are different cameras. Knows no files."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera, transform
from perception.inputs.distortion import Distortion

HIDDEN = 0.015
"""A point this much [m] behind the nearest one that falls into the same place of the colour image is hidden
there."""
STEEP = 4.0
"""Depth steps up to this many times a pixel's width are a slanted surface."""
COARSE = 0.8
"""Hiding is asked in an image this many times coarser than depth, so that a near surface has no holes."""


def to_depth_camera(
    depth: np.ndarray,
    camera: Camera,
    color_camera: Camera,
    T_color_depth: np.ndarray,
    distortion: Distortion | None,
    *images: np.ndarray | None,
) -> tuple[np.ndarray, list[np.ndarray | None]]:
    """Images of the colour camera as the depth camera's pixels see them, and the depth that they know.

    depth: (H, W) [m]; images: (h, w, ...) of the colour camera. Depth stays where it was measured, so
    nothing is interpolated. What the colour camera does not see, because something nearer is in its way,
    becomes missing: its label is not known. Outside the colour image depth stays, without a label.
    """
    points = transform(T_color_depth, camera.back_project(depth)).reshape(-1, 3)
    measured = np.flatnonzero(np.isfinite(points[:, 2]) & (points[:, 2] > 0))
    uv = _project(points[measured], color_camera, distortion)
    column, row = np.rint(uv[:, 0]).astype(np.int64), np.rint(uv[:, 1]).astype(np.int64)
    inside = (column >= 0) & (column < color_camera.width) & (row >= 0) & (row < color_camera.height)
    measured, column, row = measured[inside], column[inside], row[inside]
    kept = depth.copy()
    hidden = _hidden(points[measured, 2], column, row, color_camera, camera)
    kept.reshape(-1)[measured[hidden]] = np.nan
    seen = ~hidden
    measured, column, row = measured[seen], column[seen], row[seen]
    moved: list[np.ndarray | None] = []
    for image in images:
        if image is None:
            moved.append(None)
            continue
        own = np.zeros((depth.size, *image.shape[2:]), image.dtype)
        own[measured] = image[row, column]
        moved.append(own.reshape(*depth.shape, *image.shape[2:]))
    return kept, moved


def _project(points: np.ndarray, camera: Camera, distortion: Distortion | None) -> np.ndarray:
    if distortion is None:
        return camera.project(points)[0]
    import cv2

    zero = np.zeros(3)
    cloud = points.astype(np.float64).reshape(-1, 1, 3)
    if distortion.fisheye:
        uv, _ = cv2.fisheye.projectPoints(cloud, zero, zero, camera.K, distortion.coefficients)
    else:
        uv, _ = cv2.projectPoints(cloud, zero, zero, camera.K, distortion.coefficients)
    return np.asarray(uv).reshape(-1, 2)


def _hidden(
    z: np.ndarray, column: np.ndarray, row: np.ndarray, color_camera: Camera, camera: Camera
) -> np.ndarray:
    """Which points (N,) lie behind a nearer one in the colour image; drawn at the depth image's scale."""
    scale = COARSE * min(1.0, camera.width / color_camera.width)
    shape = (int(np.ceil(color_camera.height * scale)) + 1, int(np.ceil(color_camera.width * scale)) + 1)
    place = (row * scale).astype(np.int64) * shape[1] + (column * scale).astype(np.int64)
    nearest = np.full(shape[0] * shape[1], np.inf, np.float32)
    np.minimum.at(nearest, place, z.astype(np.float32))
    # A slanted surface falls by itself within a pixel: only a jump hides.
    slope = z / (COARSE * camera.K[0, 0])
    return np.asarray(z - nearest[place] > HIDDEN + STEEP * slope)
