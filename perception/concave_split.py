"""Parting what touches: necks and concave creases. Used by the fallback segmentation."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.depth_edges import border_pairs

STEP = 0.008
"""Distance over which surface directions are compared [m]: creases are sharp, hollows are not."""
LEAST_STEP = 3
"""The same in pixels at least, so that noise does not decide."""
CREASE_ANGLE = 30.0
"""Surface directions that turn towards each other by more than this make a crease [degrees]."""
NECK = 0.015
"""What is joined by less than this is parted [m]."""
WIDE_CONTACT = 0.4
"""Parts stay one when they run on into each other over more than this share of the smaller one's size."""
CORE_SHARE = 0.05
"""A part smaller than this share of its piece is a detail, not an object."""


def split_at_creases(
    pieces: np.ndarray,
    joined: tuple[np.ndarray, np.ndarray],
    points: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Pieces (H, W) int32 parted where a concave crease runs all through them; 0 stays 0.

    joined: as joined_neighbours gives it. points: (H, W, 3) [m], NaN where missing.
    """
    import cv2

    inside = pieces > 0
    if not inside.any():
        return pieces
    crease = _creases(points, inside, camera)
    open_image = inside & ~crease
    # Pixels at a depth jump are no core either, so that necks along a jump are cut as well.
    open_image[:, 1:] &= joined[0]
    open_image[1:] &= joined[1]
    depth = float(np.nanmedian(points[inside][:, 2]))
    radius = max(1, round(NECK / 2 * camera.K[0, 0] / depth))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    closed = cv2.morphologyEx(open_image.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    _, cores = cv2.connectedComponents(cv2.erode(closed, disk) * inside.astype(np.uint8), connectivity=4)
    size, whole = np.bincount(cores.reshape(-1)), np.bincount(pieces.reshape(-1))
    home = np.zeros(len(size), np.int64)
    home[cores.reshape(-1)] = pieces.reshape(-1)
    pixel_area = float(np.nanmedian(points[inside][:, 2])) ** 2 / (camera.K[0, 0] * camera.K[1, 1])
    large = (size > CORE_SHARE * whole[home]) & (size * pixel_area > config.segment_minimum_area)
    large[0] = False
    several = np.bincount(home[large], minlength=len(whole)) > 1
    core_at = np.zeros(pieces.shape, np.int32)
    for piece in np.flatnonzero(several):
        mine = pieces == piece
        seeds = large[cores] & mine
        # Crease pixels and details go to the nearest core of their own piece.
        _, nearest = cv2.distanceTransformWithLabels(
            (~seeds).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
        )
        core_of = np.zeros(int(nearest.max()) + 1, np.int32)
        core_of[nearest[seeds]] = cores[seeds]
        core_at[mine] = core_of[nearest[mine]]
    core_at = _merge_wide_contacts(core_at, open_image)
    result = np.where(core_at > 0, len(whole) + core_at, pieces)
    return np.unique(result, return_inverse=True)[1].reshape(pieces.shape).astype(np.int32)


def _merge_wide_contacts(core_at: np.ndarray, open_image: np.ndarray) -> np.ndarray:
    """Cores (H, W) int32 with those made one that share a wide border with neither crease nor jump."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    inner, outer = border_pairs(core_at)
    flat, smooth = core_at.reshape(-1), open_image.reshape(-1)
    contact = (flat[outer] > 0) & smooth[inner] & smooth[outer]
    size = np.bincount(flat)
    pairs, width = np.unique(
        np.stack([flat[inner[contact]], flat[outer[contact]]]), axis=1, return_counts=True
    )
    wide = width > WIDE_CONTACT * np.sqrt(np.minimum(size[pairs[0]], size[pairs[1]]))
    graph = coo_matrix((np.ones(wide.sum(), bool), pairs[:, wide]), shape=(len(size),) * 2)
    merged = connected_components(graph, directed=False)[1]
    return np.where(core_at > 0, merged[core_at] + 1, 0).astype(np.int32)


def _creases(points: np.ndarray, inside: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixels (H, W) across which the surface bends towards the camera by more than the crease angle."""
    import cv2

    depth = float(np.nanmedian(points[inside][:, 2]))
    step = max(LEAST_STEP, round(STEP * camera.K[0, 0] / depth))
    weight = cv2.blur(inside.astype(np.float32), (step, step))
    known = np.where(inside[..., None], points, 0).astype(np.float32)
    smooth = cv2.blur(known, (step, step)) / np.maximum(weight, 1e-6)[..., None]
    smooth[~inside] = np.nan
    right, down = _difference(smooth, step // 2 + 1, 1), _difference(smooth, step // 2 + 1, 0)
    normal = np.cross(down, right)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    limit = -2 * np.sin(np.radians(CREASE_ANGLE) / 2)
    crease = np.zeros(inside.shape, bool)
    with np.errstate(invalid="ignore"):
        for axis in (0, 1):
            apart, turn = _difference(smooth, step, axis), _difference(normal, step, axis)
            along = apart / np.linalg.norm(apart, axis=2, keepdims=True)
            crease |= (turn * along).sum(2) < limit
    return crease


def _difference(image: np.ndarray, step: int, axis: int) -> np.ndarray:
    """image (H, W, 3) `step` pixels ahead minus `step` pixels back along an axis; NaN at the border."""
    result = np.full(image.shape, np.nan, np.float32)
    ahead = [slice(None)] * 2
    back, middle = ahead.copy(), ahead.copy()
    ahead[axis], back[axis], middle[axis] = slice(2 * step, None), slice(None, -2 * step), slice(step, -step)
    result[tuple(middle)] = image[tuple(ahead)] - image[tuple(back)]
    return result
