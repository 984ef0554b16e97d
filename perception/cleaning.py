"""From bled masks to the pixels that are truly an object's. Everything in the camera frame."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.clusters import main_clusters
from perception.config import PerceptionConfig
from perception.depth_edges import border_pairs, depth_jump
from perception.grouping import group_by_label
from perception.joining import connected_pieces
from perception.observation import SupportPlane
from perception.quantiles import quantiles
from perception.window import window_around

OPEN_SHARE = 0.15
"""Table-height pixels with more of their border than this outside the mask lie on the table."""
JOINED_SHARE = 0.5
"""Table-height pixels that run on smoothly into their object for this share of their border are its own."""


def clean_labels(
    points: np.ndarray,
    labels: np.ndarray,
    support: SupportPlane | None,
    camera: Camera,
    config: PerceptionConfig,
    floors: dict[int, float] | None = None,
) -> np.ndarray:
    """Labels (H, W) uint16 with 0 where a labelled pixel is invalid, on the table, or off its object.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing. floors: label -> height over the
    support plane of the support that it stands on [m], 0 where none is given.
    """
    raw = labels.reshape(-1)
    pixels = np.flatnonzero((raw > 0) & np.isfinite(points[..., 2].reshape(-1)))
    cleaned = np.zeros_like(raw)
    if support is not None and pixels.size:
        pixels = pixels[~_on_table(points, labels, pixels, support, camera, config, floors or {})]
    if pixels.size:
        kept = pixels[main_clusters(points, labels, pixels, support, camera, config)]
        cleaned[kept] = raw[kept]
    return cleaned.reshape(labels.shape)


def _on_table(
    points: np.ndarray,
    labels: np.ndarray,
    pixels: np.ndarray,
    support: SupportPlane,
    camera: Camera,
    config: PerceptionConfig,
    floors: dict[int, float],
) -> np.ndarray:
    """Which labelled pixels (N,) see their support or what is under it: bleed of the mask."""
    own, label = points.reshape(-1, 3)[pixels], labels.reshape(-1)[pixels]
    height = own @ support.normal.astype(np.float32) + np.float32(support.offset)
    noise = np.float32(config.depth_noise) * own[:, 2] ** 2
    limit = np.maximum(np.float32(config.table_margin), 1.5 * noise)
    for name, mine in group_by_label(label):
        height[mine] -= np.float32(floors.get(name, 0.0))
        # Nearly all of a plate or a knife lies within the noise of the table: only what is below can go.
        if quantiles(height[mine[:: 1 + len(mine) // 2000]], 0.95)[0] < config.flat_height:
            limit[mine] = -noise[mine]
    low = height < limit
    if low.any():
        bottom = low & (height > -config.plane_threshold)
        if bottom.any():  # a mask may leak over the table's edge and be eroded where it meets the table
            low &= ~(bottom & _enclosed(points, labels, pixels, bottom, camera, config))
    return low


def _enclosed(
    points: np.ndarray,
    labels: np.ndarray,
    pixels: np.ndarray,
    bottom: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which of the table-height pixels (N,) are the inside of a bowl or plate.

    The object surrounds them and runs on into them without a jump. The table seen through
    a handle is surrounded too, but behind a jump.
    """
    mask = np.zeros(labels.shape, bool)
    mask.reshape(-1)[pixels[bottom]] = True
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
    return mask.reshape(-1)[pixels]
