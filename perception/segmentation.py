"""Fallback instance segmentation for frames without labels: remove the support plane, cluster the rest."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.cleaning import depth_jump
from perception.config import PerceptionConfig
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
    pieces, count = connected_pieces(depth, candidate, camera, config)
    area = np.nan_to_num(depth) ** 2 / (camera.K[0, 0] * camera.K[1, 1])
    areas = np.bincount(pieces.reshape(-1), weights=area.reshape(-1), minlength=count)
    keep = areas >= config.segment_minimum_area
    keep[0] = False
    number = np.where(keep, np.cumsum(keep), 0).astype(np.uint16)
    return number[pieces]


def connected_pieces(
    depth: np.ndarray, mask: np.ndarray, camera: Camera, config: PerceptionConfig
) -> tuple[np.ndarray, int]:
    """Pieces (H, W) int32 of the mask joined by neighbours without a depth jump, 0 elsewhere; their count.

    The image is spread to twice its size with the joints between pixels in the odd rows and columns,
    so that OpenCV's component labelling can respect the jumps.
    """
    import cv2

    jump = depth_jump(depth, camera, config)
    spread = np.zeros((2 * camera.height - 1, 2 * camera.width - 1), np.uint8)
    with np.errstate(invalid="ignore"):
        spread[::2, ::2] = mask
        spread[::2, 1::2] = mask[:, 1:] & mask[:, :-1] & (np.abs(np.diff(depth, axis=1)) < jump[:, 1:])
        spread[1::2, ::2] = mask[1:] & mask[:-1] & (np.abs(np.diff(depth, axis=0)) < jump[1:])
    count, pieces = cv2.connectedComponents(spread, connectivity=4)
    return np.ascontiguousarray(pieces[::2, ::2]), count
