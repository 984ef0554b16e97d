"""Labels that were resized by interpolation or saved as JPEG: false numbers along the borders, found and
mended."""

from __future__ import annotations

import numpy as np

BETWEEN_SHARE = 0.6
"""A piece without a core, of which more than this lies between a lower and a higher number, is a sliver."""
LEAST_SLIVERS = 4
"""So many slivers make a label image interpolated ..."""
LEAST_PIXELS = 20
"""... if they have so many pixels together."""
BORDER_SHARE = 0.1
"""... and are this share of the labels' borders: single thin strips are things half hidden."""
REACH = 2
"""Pixels this near are looked at for a lower and a higher number [px]."""


def without_slivers(image: np.ndarray) -> tuple[np.ndarray, int, list[int]]:
    """The labels (H, W) uint16 with slivers given to the nearest label that is none; how many pixels changed,
    and the numbers that vanished.

    A sliver is a thin piece whose number lies between those on its two sides, as interpolation makes them:
    1, 2, 3, 4 around an object 5. A pen or a wire has the background on both sides and stays.
    """
    import cv2

    if image.max() < 2:
        return image, 0, []
    small, large = np.ones((3, 3), np.uint8), np.ones((2 * REACH + 1,) * 2, np.uint8)
    low, high = cv2.erode(image, small), cv2.dilate(image, small)
    edge = low != high
    if not ((image > low) & (image < high)).any():
        return image, 0, []
    between = (image > cv2.erode(image, large)) & (image < cv2.dilate(image, large))
    pieces = _pieces(image)
    count = int(pieces.max()) + 1
    size = np.bincount(pieces.reshape(-1), minlength=count)
    core = np.bincount(pieces[~edge], minlength=count)
    inside = np.bincount(pieces[between], minlength=count)
    sliver = (core == 0) & (inside > BETWEEN_SHARE * size)
    sliver[0] = False
    changed = sliver[pieces] & (image > 0)
    if sliver.sum() < LEAST_SLIVERS or changed.sum() < max(
        LEAST_PIXELS, BORDER_SHARE * (edge & (image > 0)).sum()
    ):
        return image, 0, []
    from scipy.ndimage import distance_transform_edt

    rows, columns = distance_transform_edt(changed, return_distances=False, return_indices=True)
    mended = image[rows, columns]
    vanished = sorted(set(np.unique(image[changed]).tolist()) - set(np.unique(mended).tolist()))
    return mended, int(changed.sum()), vanished


def _pieces(image: np.ndarray) -> np.ndarray:
    """Number (H, W) of the connected piece of equal labels each pixel is part of; background counts as
    well."""
    from perception.depth_edges import connected_pieces

    right, down = image[:, 1:] == image[:, :-1], image[1:] == image[:-1]
    return connected_pieces(right, down, np.ones(image.shape, bool))
