"""What was measured and carries no label: supports, and everything else, which is an obstacle.

Knows heights over the supports; knows nothing of shapes. Labels that were dropped count as none.
"""

from __future__ import annotations

import numpy as np

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
    depth = points[..., 2]
    seen = cleaned.astype(np.int32)
    bare = seen == 0
    seen[bare] = OTHER
    if support is not None:
        height = points @ support.normal.astype(np.float32)
        height += np.float32(support.offset)
        limit = np.float32(config.depth_noise) * depth
        limit *= depth
        limit += np.float32(support.threshold)
        for of_one in heights:
            seen[bare & (np.abs(height - np.float32(of_one)) < limit)] = SUPPORT
    seen[np.isnan(depth)] = NOTHING
    return seen
