"""What was measured and carries no label: supports, and everything else, which is an obstacle.

Knows heights over the supports; knows nothing of shapes. Labels that were dropped count as none.
"""

from __future__ import annotations

import numpy as np

from perception.config import PerceptionConfig
from perception.observation import NOTHING, OTHER, SUPPORT, SupportPlane


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
