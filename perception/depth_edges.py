"""Where a depth image is one surface and where it jumps: flying pixels, joints, borders of regions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mapping.compiled import compiled
from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.filling import filled

FEW = 2
"""A pixel of a surface, however thin, joins more of its neighbours than this, or nothing lies behind it."""
REACH = 3
"""So far sensors draw an edge out [px]."""


def depth_jump(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """Depth step [m] between neighbouring pixels that no surface in sight explains; depth (...) [m]."""
    linear, square = _jump_factors(camera, config)
    return linear * depth + square * depth * depth


def _jump_factors(camera: Camera, config: PerceptionConfig) -> tuple[np.float32, np.float32]:
    """What depth and its square are multiplied by in a jump: pixels apart at a grazing angle, and noise."""
    per_pixel = np.tan(np.radians(config.grazing_angle)) / min(camera.K[0, 0], camera.K[1, 1])
    return np.float32(per_pixel), np.float32(2 * config.depth_noise)


def remove_flying_pixels(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """A copy of depth (H, W) [m] with NaN where a pixel hangs between a nearer and a farther surface.

    Such pixels mix foreground and background. A thin object is the nearest of its neighbourhood, so it stays.
    Where a sensor draws an edge out over several pixels, what is left between the two surfaces has few
    neighbours that it joins: those look as far as the surfaces are.
    """
    import cv2

    kernel = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(filled(depth, np.inf), kernel)
    farthest = cv2.dilate(filled(depth, 0.0), kernel)
    linear, square = _jump_factors(camera, config)
    cleaned = _without_between(np.ascontiguousarray(depth), nearest, farthest, linear, square)
    _drop_remnants(cleaned, linear, square)
    return cleaned


@compiled
def _without_between(
    depth: np.ndarray, nearest: np.ndarray, farthest: np.ndarray, linear: np.float32, square: np.float32
) -> np.ndarray:
    """A copy of depth (H, W) with NaN where both the nearest and the farthest around are a jump away."""
    cleaned = np.empty_like(depth)
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            own = depth[row, column]
            jump = linear * own + square * own * own
            flying = own - nearest[row, column] > jump and farthest[row, column] - own > jump
            cleaned[row, column] = np.float32(np.nan) if flying else own
    return cleaned


@compiled
def _drop_remnants(depth: np.ndarray, linear: np.float32, square: np.float32) -> None:
    """NaN where a pixel of depth (H, W) joins at most FEW of the eight around it, and within REACH pixels
    both a nearer and a farther one are a jump away."""
    height, width = depth.shape
    found = [0 for _ in range(0)]  # no pixels yet, but of a known type
    for row in range(height):
        for column in range(width):
            own = depth[row, column]
            if np.isnan(own):
                continue
            jump, joined = linear * own + square * own * own, 0
            if 0 < row < height - 1 and 0 < column < width - 1:  # nearly all need no further look
                joined += abs(depth[row, column - 1] - own) < jump
                joined += abs(depth[row, column + 1] - own) < jump
                joined += abs(depth[row - 1, column] - own) < jump
                joined += abs(depth[row + 1, column] - own) < jump
                if joined > FEW:
                    continue
                joined = 0
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(column - 1, 0), min(column + 2, width)):
                    joined += abs(depth[r, c] - own) < jump
                if joined > FEW + 1:  # itself among them
                    break
            if joined > FEW + 1:
                continue
            nearer = farther = False
            for r in range(max(row - REACH, 0), min(row + REACH + 1, height)):
                for c in range(max(column - REACH, 0), min(column + REACH + 1, width)):
                    nearer |= own - depth[r, c] > jump
                    farther |= depth[r, c] - own > jump
            if nearer and farther:
                found.append(row * width + column)
    for pixel in found:
        depth.reshape(-1)[pixel] = np.nan


def joined_neighbours(
    depth: np.ndarray, camera: Camera, config: PerceptionConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Whether a pixel and its right (H, W-1) or lower (H-1, W) neighbour are measured without a jump."""
    jump = depth_jump(depth, camera, config)
    with np.errstate(invalid="ignore"):
        return np.abs(np.diff(depth, axis=1)) < jump[:, 1:], np.abs(np.diff(depth, axis=0)) < jump[1:]


def beyond_mask(pixels: np.ndarray, raw: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours across the border of a mask (E,): which of its pixels, and the flat index beyond it.

    pixels: (N,) flat indices, of one label; raw: (H * W,) labels; width: of the image.
    """
    which, outer = [], []
    for own, other in _neighbours(pixels, width, len(raw)):
        beyond = raw[other] != raw[pixels[0]]
        which.append(own[beyond])
        outer.append(other[beyond])
    return np.concatenate(which), np.concatenate(outer)


def border_pairs(region: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices (E,) of neighbouring pixels: inside a region, and the one next to it that is not.

    region: (H, W) number of the region each pixel belongs to, 0 = none.
    """
    flat = region.reshape(-1)
    pixels = np.flatnonzero(flat > 0)
    inner, outer = [], []
    for own, other in _neighbours(pixels, region.shape[1], len(flat)):
        border = flat[pixels[own]] != flat[other]
        inner.append(pixels[own[border]])
        outer.append(other[border])
    return np.concatenate(inner), np.concatenate(outer)


def _neighbours(pixels: np.ndarray, width: int, size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Left, right, above and below: which of the pixels (N,), flat indices in an image of `size` pixels, have
    such a neighbour, and its flat index."""
    column = pixels % width
    for step, inside in (
        (-1, column > 0),
        (1, column < width - 1),
        (-width, pixels >= width),
        (width, pixels < size - width),
    ):
        own = np.flatnonzero(inside)
        yield own, pixels[own] + step
