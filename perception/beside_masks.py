"""Places that only masks say are empty: their rays measured nothing, and pass well beside all objects' masks.

Knows an observation and its rays; knows nothing of samples or surfaces.
"""

from __future__ import annotations

import numpy as np

from perception.observation import Observation
from perception.space import Space

BESIDE = 2
"""Masks are known to this [px]."""


def beside_all_masks(observation: Observation, space: Space, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) lie on rays that measured nothing, well beside the masks of all objects: (N,) bool.

    Were an object there, its mask would say so, whatever the depth image lacks.
    """
    if "bare" not in observation.memo:
        observation.memo["bare"] = _bare(observation)
    pixel = space.pixel_of(points)
    return np.asarray((pixel >= 0) & observation.memo["bare"][pixel])


def _bare(observation: Observation) -> np.ndarray:
    """Pixels (H W,) bool of such rays."""
    import cv2

    bare = np.ones(observation.depth.size, np.uint8)
    bare[np.isfinite(observation.depth.reshape(-1))] = 0
    for item in observation.objects:
        bare[item.silhouette] = 0
        bare[item.pixels] = 0
    size = 2 * BESIDE + 1
    wide = cv2.erode(bare.reshape(observation.depth.shape), np.ones((size, size), np.uint8))
    return np.asarray(wide.reshape(-1) > 0)
