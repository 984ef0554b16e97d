"""Fallback instance segmentation for frames without labels: remove the support plane, cluster the rest."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.depth_edges import connected_pieces, joined_neighbours
from perception.observation import SupportPlane


def segment(
    points: np.ndarray, support: SupportPlane | None, camera: Camera, config: PerceptionConfig
) -> np.ndarray:
    """Instance labels (H, W) uint16 of what stands on the support plane, 0 elsewhere.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing.
    """
    depth = points[..., 2]
    candidate = np.isfinite(depth)
    if support is not None:
        height = points @ support.normal.astype(np.float32) + np.float32(support.offset)
        candidate &= height > config.segment_height
    pieces = connected_pieces(*joined_neighbours(depth, camera, config), candidate)
    area = np.nan_to_num(depth) ** 2 / (camera.K[0, 0] * camera.K[1, 1])
    areas = np.bincount(pieces.reshape(-1), weights=area.reshape(-1))
    keep = areas >= config.segment_minimum_area
    keep[0] = False
    number = np.where(keep, np.cumsum(keep), 0).astype(np.uint16)
    return number[pieces]
