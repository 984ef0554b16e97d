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
    count, pieces, boxes, _ = cv2.connectedComponentsWithStats(low.astype(np.uint8), connectivity=4)
    for number in range(1, count):
        left, top, width, height, _ = boxes[number].tolist()
        # Nothing farther from a piece than its ring has a say.
        part = (
            slice(max(top - RING, 0), top + height + RING),
            slice(max(left - RING, 0), left + width + RING),
        )
        own = pieces[part] == number
        core = own & (inner[part] > 0)
        if np.count_nonzero(core) < LEAST_PIXELS:
            continue
        near = cv2.dilate(own.astype(np.uint8), _disc(RING)) > 0
        ring = support[part] & near & ~(cv2.dilate(own.astype(np.uint8), _disc(APART)) > 0)
        if np.count_nonzero(ring) < LEAST_PIXELS:
            continue
        level = float(np.median(heights[part][ring]))
        out = float(np.median(heights[part][core])) - level
        if out > max(STANDS_OUT, NOISES * noise):
            found[part] |= own & (_smoothed(heights[part], own) > level + out / 2)
    return found


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _smoothed(heights: np.ndarray, own: np.ndarray) -> np.ndarray:
    """The mean height (H, W) of those of `own` (H, W) that are no farther than a rim's width."""
    size = (2 * RIM + 1, 2 * RIM + 1)
    sums = cv2.boxFilter(np.where(own, heights, 0).astype(np.float32), -1, size, normalize=False)
    count = cv2.boxFilter(own.astype(np.float32), -1, size, normalize=False)
    return np.asarray(sums / np.maximum(count, 1))
