"""Where a depth image is one surface and where it jumps: flying pixels, pieces, borders of regions."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig


def depth_jump(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """Depth step [m] between neighbouring pixels that no surface in sight explains; depth (...) [m]."""
    per_pixel = np.tan(np.radians(config.grazing_angle)) / min(camera.K[0, 0], camera.K[1, 1])
    return np.float32(per_pixel) * depth + np.float32(2 * config.depth_noise) * depth * depth


def remove_flying_pixels(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """A copy of depth (H, W) [m] with NaN where a pixel hangs between a nearer and a farther surface.

    Such pixels mix foreground and background. A thin object is the nearest of its
    neighbourhood, so it stays.
    """
    import cv2

    jump = depth_jump(depth, camera, config)
    missing = np.isnan(depth)
    kernel = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(np.where(missing, np.float32(np.inf), depth), kernel)
    farthest = cv2.dilate(np.where(missing, np.float32(0), depth), kernel)
    flying = (depth - nearest > jump) & (farthest - depth > jump)
    cleaned = depth.copy()
    cleaned[flying] = np.nan
    return cleaned


def connected_pieces(joined_right: np.ndarray, joined_down: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Number (H, W) int32 of the piece each pixel of mask (H, W) belongs to, 0 outside the mask.

    joined_right (H, W-1) and joined_down (H-1, W): whether a pixel and the next one are one surface.
    The image is spread to twice its size with the joints in the odd rows and columns, so that OpenCV's
    component labelling can respect them.
    """
    import cv2

    height, width = mask.shape
    spread = np.zeros((2 * height - 1, 2 * width - 1), np.uint8)
    spread[::2, ::2] = mask
    spread[::2, 1::2] = joined_right & mask[:, 1:] & mask[:, :-1]
    spread[1::2, ::2] = joined_down & mask[1:] & mask[:-1]
    _, pieces = cv2.connectedComponents(spread, connectivity=4)
    return np.ascontiguousarray(pieces[::2, ::2])


def joined_neighbours(
    depth: np.ndarray, camera: Camera, config: PerceptionConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a pixel and its right (H, W-1) or lower (H-1, W) neighbour are measured without a jump."""
    jump = depth_jump(depth, camera, config)
    with np.errstate(invalid="ignore"):
        return np.abs(np.diff(depth, axis=1)) < jump[:, 1:], np.abs(np.diff(depth, axis=0)) < jump[1:]


def border_pairs(region: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices (E,) of neighbouring pixels: inside a region, and the one next to it that is not.

    region: (H, W) number of the region each pixel belongs to, 0 = none.
    """
    height, width = region.shape
    flat = region.reshape(-1)
    pixels = np.flatnonzero(flat > 0)
    column = pixels % width
    inner, outer = [], []
    for step, inside in (
        (-1, column > 0),
        (1, column < width - 1),
        (-width, pixels >= width),
        (width, pixels < (height - 1) * width),
    ):
        own = pixels[inside]
        other = own + step
        border = flat[own] != flat[other]
        inner.append(own[border])
        outer.append(other[border])
    return np.concatenate(inner), np.concatenate(outer)
