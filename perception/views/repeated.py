"""Whether a frame is another one once more: it says nothing new, and to count it twice would lend it weight.

Knows frames; knows nothing of what they show.
"""

from __future__ import annotations

import numpy as np

from perception.frame import Frame


def same_view(a: Frame, b: Frame) -> bool:
    """Whether two frames have one pose and depth image, and labels in the same places, whatever their
    numbers. Two images of a camera that stands still are two views as soon as their noise differs."""
    if not np.array_equal(a.camera.T_world_camera, b.camera.T_world_camera):
        return False
    if not np.array_equal(a.camera.K, b.camera.K) or not np.array_equal(a.depth, b.depth, equal_nan=True):
        return False
    if a.labels is None or b.labels is None:
        return a.labels is b.labels
    return np.array_equal(a.labels > 0, b.labels > 0)
