"""Depth images whose missing pixels hold a number, as filters over neighbours need them."""

from __future__ import annotations

import numpy as np


def filled(depth: np.ndarray, value: float) -> np.ndarray:
    """A copy of depth (H, W) float32 [m] with a value where nothing was measured."""
    import cv2

    copy = np.array(depth, np.float32, order="C")
    cv2.patchNaNs(copy, value)
    return copy
