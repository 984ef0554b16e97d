"""Flat parts of an object that lie on its support: a book end's foot, a clip's arm, a pan's handle.

Knows heights above a support and masks; knows nothing of cameras or clusters. A mask that bleeds takes the
support itself, as high as the support beside it; a part that stands out of that, over more than a rim's
width, is the object's, however little it stands out.
"""

from __future__ import annotations

import cv2
import numpy as np

RIM = 2
"""So near to its border [px] a part may be a ramp between an object and its support, as sensors see it."""
LEAST_PIXELS = 20
"""Fewer pixels that are no rim, or of the support around, say nothing."""
RING = 8
"""The support around a part is looked for within so many pixels ..."""
APART = 2
"""... that are no nearer to it than this."""
STANDS_OUT, NOISES = 0.001, 0.5
"""A part stands out that is so much higher than the support around it [m], or by this share of the noise of a
pixel."""


def raised_parts(
    heights: np.ndarray, low: np.ndarray, bare: np.ndarray, noise: float, within: float
) -> np.ndarray:
    """Which of the pixels `low` (H, W) bool of one mask stand out of the support around them: (H, W) bool.

    heights: (H, W) above the support [m], NaN where nothing was measured; bare: (H, W) pixels without any
    label; noise: of one height [m]; within: what is farther than this from the support [m] is none of it.
    """
    found = np.zeros(low.shape, bool)
    inner = cv2.erode(low.astype(np.uint8), _disc(RIM), borderValue=0)
    if np.count_nonzero(inner) < LEAST_PIXELS:
        return found
    support = bare & (np.abs(heights) < within)
    count, piece = cv2.connectedComponents(low.astype(np.uint8), connectivity=4)
    for number in range(1, count):
        own = piece == number
        core = own & (inner > 0)
        near = cv2.dilate(own.astype(np.uint8), _disc(RING)) > 0
        ring = support & near & ~(cv2.dilate(own.astype(np.uint8), _disc(APART)) > 0)
        if min(np.count_nonzero(core), np.count_nonzero(ring)) < LEAST_PIXELS:
            continue
        level = float(np.median(heights[ring]))
        out = float(np.median(heights[core])) - level
        if out > max(STANDS_OUT, NOISES * noise):
            found |= own & (_smoothed(heights, own) > level + out / 2)
    return found


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _smoothed(heights: np.ndarray, own: np.ndarray) -> np.ndarray:
    """The mean height (H, W) of those of `own` (H, W) that are no farther than a rim's width."""
    size = (2 * RIM + 1, 2 * RIM + 1)
    sums = cv2.boxFilter(np.where(own, heights, 0).astype(np.float32), -1, size, normalize=False)
    count = cv2.boxFilter(own.astype(np.float32), -1, size, normalize=False)
    return np.asarray(sums / np.maximum(count, 1))
