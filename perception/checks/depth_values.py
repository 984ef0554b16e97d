"""Numbers in a depth image that are no measurement: sentinels at the far end, and lone far pixels."""

from __future__ import annotations

import numpy as np

from perception.filling import filled
from perception.window import window_around

SENTINEL_PIXELS = 20
"""A far value that stands for "nothing" is there at least this often, to the bit."""
SENTINEL_GAP = 1.5
"""... and is this many times farther than everything else."""
MOST_SENTINELS = 3
"""Different sentinels looked for, one after another (65535, and a far clipping plane)."""
FAR_RATIO = 1.25
"""A lone pixel this many times farther than the nearest opening around it is an error, not a view."""
NOWHERE = 1e30
"""Stands for "not measured" where a minimum is taken [m]."""
WINDOW = 3
"""What holds no block of this size is lone [px]."""


def without_sentinels(depth: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Depth (H, W) float32 [m] with NaN where pixels hold a value for "no return"; and a note for each value.

    Such a value is the largest, many pixels have it to the bit, and nothing lies just before it. A ray
    through it would count as free all the way, so that tunnels are cut through objects.
    """
    notes: list[str] = []
    for _ in range(MOST_SENTINELS):
        filled = np.where(np.isnan(depth), np.float32(0), depth)
        top = filled.max(initial=0.0)
        at_top = filled == top
        count = int(at_top.sum())
        if top <= 0 or count < SENTINEL_PIXELS or count == depth.size:
            break
        below = float(np.where(at_top, np.float32(0), filled).max())
        if below <= 0 or top < SENTINEL_GAP * below:
            break
        depth = np.where(at_top, np.float32(np.nan), depth)
        notes.append(
            f"{count} depth pixels hold {top:.6g} m exactly, everything else is nearer than {below:.3g} m: "
            f"taken as "
            "missing"
        )
    return depth, notes


def without_lone_far(depth: np.ndarray, labels: np.ndarray | None) -> tuple[np.ndarray, int]:
    """Depth (H, W) float32 [m] with NaN at lone pixels of a mask far behind all around; how many they were.

    Only within masks: there such a pixel cuts a tunnel through an object, elsewhere it is a view past things.
    labels: (H, W), 0 = no mask, or None.
    """
    import cv2

    if labels is None or not (masks := labels > 0).any():
        return depth, 0
    part = window_around(masks, WINDOW)  # as far as an opening looks around them
    known = filled(depth[part], NOWHERE)
    kernel = np.ones((WINDOW, WINDOW), np.uint8)
    opened = cv2.dilate(cv2.erode(known, kernel), kernel)
    lone = (known > np.float32(FAR_RATIO) * opened) & (known < NOWHERE) & (opened < NOWHERE) & masks[part]
    count = int(np.count_nonzero(lone))
    if not count:
        return depth, 0
    depth = depth.copy()
    depth[part][lone] = np.nan
    return depth, count
