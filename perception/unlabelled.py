"""What was measured and carries no label: supports, and everything else, which is an obstacle.

Knows heights over the supports; knows nothing of shapes. Labels that were dropped count as none.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from perception.config import PerceptionConfig
from perception.observation import NOTHING, OTHER, SUPPORT, SupportPlane

RIM = 0.006
"""What is narrower than twice this is a rim that a mask left over, or a splinter: it hides nothing [m]."""


def bulky(seen: np.ndarray, depth: np.ndarray, focal: float) -> np.ndarray:
    """Which pixels (H, W) bool of obstacles belong to something wider than the rim that a tight mask leaves.

    seen: (H, W) as what_pixels_see gives it; depth: (H, W) [m]; focal: [px].
    """
    import cv2

    other = seen == OTHER
    if not other.any():
        return other
    radius = int(np.clip(np.ceil(RIM * focal / np.median(depth[other])), 2, 15))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    core = cv2.morphologyEx(other.astype(np.uint8), cv2.MORPH_OPEN, disc)
    return other & (core > 0)


def what_pixels_see(
    points: np.ndarray,
    cleaned: np.ndarray,
    support: SupportPlane | None,
    heights: tuple[float, ...],
    config: PerceptionConfig,
) -> np.ndarray:
    """(H, W) int32: the label seen, or OTHER, SUPPORT or NOTHING.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing; cleaned: (H, W) labels of surfaces;
    heights: of all supports over the first one [m].
    """
    if support is None:
        height, levels, threshold = points[..., 2], np.empty(0, np.float32), 0.0
    else:
        height = points @ support.normal.astype(np.float32)
        height += np.float32(support.offset)
        levels, threshold = np.array(heights, np.float32), support.threshold
    return _seen(points, cleaned, height, levels, np.float32(config.depth_noise), np.float32(threshold))


@compiled
def _seen(
    points: np.ndarray,
    cleaned: np.ndarray,
    height: np.ndarray,
    levels: np.ndarray,
    noise: np.float32,
    threshold: np.float32,
) -> np.ndarray:
    """What each pixel sees, from its height (H, W) over the first support and those of all supports (L,)."""
    seen = np.empty(height.shape, np.int32)
    for row in range(height.shape[0]):
        for column in range(height.shape[1]):
            # Without branches: which pixels lie on a support is hard to foretell where it is noisy.
            depth = points[row, column, 2]
            limit = noise * depth * depth + threshold
            on_support = False
            for level in range(len(levels)):
                on_support |= abs(height[row, column] - levels[level]) < limit
            bare = SUPPORT if on_support else OTHER
            kind = cleaned[row, column] if cleaned[row, column] else bare
            seen[row, column] = NOTHING if np.isnan(depth) else kind
    return seen
