"""From bled masks to the pixels that are truly an object's. Everything in the camera frame."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.clusters import main_cluster
from perception.config import PerceptionConfig
from perception.depth_edges import border_pairs, depth_jump
from perception.joining import connected_pieces
from perception.observation import SupportPlane
from perception.quantiles import quantiles
from perception.raised_parts import RING, raised_parts
from perception.window import window_around

OPEN_SHARE = 0.15
"""Table-height pixels with more of their border than this outside the mask lie on the table."""
JOINED_SHARE = 0.5
"""Table-height pixels that run on smoothly into their object for this share of their border are its own."""


def clean_labels(
    points: np.ndarray,
    labels: np.ndarray,
    measured: dict[int, np.ndarray],
    support: SupportPlane | None,
    camera: Camera,
    config: PerceptionConfig,
    floors: dict[int, float] | None = None,
) -> np.ndarray:
    """Labels (H, W) uint16 with 0 where a labelled pixel is invalid, on the table, or off its object.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing. measured: label -> flat indices of
    its pixels that are not. floors: label -> height over the support plane of the support that it stands on
    [m], 0 where none is given.
    """
    cleaned = np.zeros_like(labels)
    for label, pixels in measured.items():
        if support is not None:
            floor = (floors or {}).get(label, 0.0)
            pixels = pixels[~_on_table(points, labels, pixels, support, floor, camera, config)]
        if pixels.size:
            own = main_cluster(points, labels, pixels, support, camera, config)
            cleaned.reshape(-1)[pixels[own]] = label
    return cleaned


def _on_table(
    points: np.ndarray,
    labels: np.ndarray,
    pixels: np.ndarray,
    support: SupportPlane,
    floor: float,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which pixels (N,) of a mask see its support or what is under it: bleed of the mask."""
    own = points.reshape(-1, 3).take(pixels, axis=0)
    height = own @ support.normal.astype(np.float32)
    height += np.float32(support.offset)
    height -= np.float32(floor)
    noise = np.float32(config.depth_noise) * own[:, 2] ** 2
    # Nearly all of a plate or a knife lies within the noise of the table: only what is below can go.
    if quantiles(height[:: 1 + len(height) // 2000], 0.95)[0] < config.flat_height:
        limit = -noise
    else:
        limit = np.maximum(np.float32(config.table_margin), 1.5 * noise)
    low = height < limit
    bottom = low & (height > -config.plane_threshold)
    if bottom.any():  # a mask may leak over the table's edge and be eroded where it meets the table
        low[bottom] = ~_enclosed(points, labels, pixels[bottom], camera, config)
    if low.any():
        usual = float(np.median(noise))
        low[low] = ~_raised(points, labels, pixels[low], support, floor, usual, config)
    return low


def _raised(
    points: np.ndarray,
    labels: np.ndarray,
    low: np.ndarray,
    support: SupportPlane,
    floor: float,
    noise: float,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which table-height pixels of a mask, flat indices (N,), stand out of the table around them: (N,)."""
    mask = np.zeros(labels.shape, bool)
    mask.reshape(-1)[low] = True
    part = window_around(mask, RING)
    heights = points[part] @ support.normal.astype(np.float32) + np.float32(support.offset - floor)
    mask[part] = raised_parts(heights, mask[part], labels[part] == 0, noise, config.plane_threshold)
    return mask.reshape(-1)[low]


def _enclosed(
    points: np.ndarray, labels: np.ndarray, bottom: np.ndarray, camera: Camera, config: PerceptionConfig
) -> np.ndarray:
    """Which table-height pixels of a mask, flat indices (N,), are the inside of a bowl or plate: (N,) bool.

    The object surrounds them and runs on into them without a jump. The table seen through
    a handle is surrounded too, but behind a jump.
    """
    mask = np.zeros(labels.shape, bool)
    mask.reshape(-1)[bottom] = True
    part = window_around(mask, 1)
    raw, depth = labels[part].reshape(-1), points[part][..., 2].reshape(-1)
    same_right = labels[part][:, 1:] == labels[part][:, :-1]
    same_down = labels[part][1:] == labels[part][:-1]
    region = connected_pieces(same_right, same_down, mask[part])
    inner, outer = border_pairs(region)
    of = region.reshape(-1)[inner]
    outside = raw[inner] != raw[outer]
    joined = ~outside & (np.abs(depth[outer] - depth[inner]) < depth_jump(depth[inner], camera, config))
    count = int(region.max()) + 1
    total = np.maximum(1, np.bincount(of, minlength=count))
    inside = (np.bincount(of, weights=outside, minlength=count) <= OPEN_SHARE * total) & (
        np.bincount(of, weights=joined, minlength=count) >= JOINED_SHARE * total
    )
    mask[part] = inside[region]
    return mask.reshape(-1)[bottom]
