"""Boxes around points: along the axes, and the smallest upright one. Knows points only."""

from __future__ import annotations

import numpy as np

DIRECTIONS = 8
"""So many outermost points, in directions all round, say which others cannot be on the hull."""
WELL_INSIDE = np.float32(1e-4)
"""Points at least this far within these [m] are not on it, whatever is rounded."""


def bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner (3,) of points (N, 3), one or more."""
    axes = np.ascontiguousarray(points.T)  # NumPy is slow at the least of a few numbers a row
    return axes.min(1), axes.max(1)


def upright_box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) and size (3,) of the smallest box around points (V, 3) whose z axis stays vertical."""
    import cv2

    (x, y), (width, depth), degrees = cv2.minAreaRect(_outer(points[:, :2].astype(np.float32)))
    bottom, top = points[:, 2].min(), points[:, 2].max()
    angle = np.radians(degrees)
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = [x, y, (bottom + top) / 2]
    return T, np.array([width, depth, top - bottom])


def _outer(points: np.ndarray) -> np.ndarray:
    """Those of points (N, 2) float32 that may be on their hull: OpenCV sorts all that it is given."""
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    directions = np.stack([np.cos(angle), np.sin(angle)], 1).astype(np.float32)
    axes = np.ascontiguousarray(points.T)
    corners = points[(directions @ axes).argmax(1)]  # counter-clockwise
    along = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(*along.T)
    corners, along, length = corners[length > 0], along[length > 0], length[length > 0]
    inwards = np.stack([-along[:, 1], along[:, 0]], 1) / length[:, None]
    inside = (inwards @ axes > ((inwards * corners).sum(1) + WELL_INSIDE)[:, None]).all(0)
    return points[~inside]
