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
LEAST_CORE = 12
"""A true number has so many pixels without another number beside them."""
JPEG_ERROR, JPEG_TIMES = 8, 5
"""A number this near to one with so many times its pixels is JPEG's error."""
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
    between = (image > cv2.erode(image, large)) & (image < cv2.dilate(image, large))
    enough = max(LEAST_PIXELS, BORDER_SHARE * int((edge & (image > 0)).sum()))
    if int((edge & between).sum()) < enough:
        return image, 0, []
    pieces = _pieces(image)
    count = int(pieces.max()) + 1
    size = np.bincount(pieces.reshape(-1), minlength=count)
    core = np.bincount(pieces[~edge], minlength=count)
    inside = np.bincount(pieces[between], minlength=count)
    sliver = (core == 0) & (inside > BETWEEN_SHARE * size)
    sliver[0] = False
    changed = sliver[pieces] & (image > 0)
    if sliver.sum() < LEAST_SLIVERS or changed.sum() < enough:
        return image, 0, []
    from scipy.ndimage import distance_transform_edt

    whole = np.isin(image, _true_numbers(image[~edge])) & (core[pieces] > 0)
    rows, columns = distance_transform_edt(~whole, return_distances=False, return_indices=True)
    mended = image[rows, columns]
    changed = mended != image
    vanished = sorted(set(np.unique(image[changed]).tolist()) - set(np.unique(mended).tolist()))
    return mended, int(changed.sum()), vanished


def _true_numbers(inner: np.ndarray) -> list[int]:
    """The numbers that objects have, from the pixels (N,) without another number beside them.

    JPEG puts patches of 19 and 21 into an object 20: where most numbers have a much larger neighbour among
    the numbers, only the large ones are true.
    """
    numbers, count = np.unique(inner, return_counts=True)
    enough = (count >= LEAST_CORE) | (numbers == 0)
    numbers, count = numbers[enough].astype(np.int64), count[enough]
    large: list[int] = []
    for index in np.argsort(-count):
        near = [other for other in large if abs(other - numbers[index]) <= JPEG_ERROR]
        if not near or count[index] * JPEG_TIMES > count[numbers == near[0]][0]:
            large.append(int(numbers[index]))
    return large if 2 * len(large) <= len(numbers) else numbers.tolist()


def _pieces(image: np.ndarray) -> np.ndarray:
    """Number (H, W) of the connected piece of equal labels each pixel is part of; background counts as
    well."""
    from perception.joining import connected_pieces

    right, down = image[:, 1:] == image[:, :-1], image[1:] == image[:-1]
    return connected_pieces(right, down, np.ones(image.shape, bool))
