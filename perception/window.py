"""The part of an image that there is something to do in."""

from __future__ import annotations

import numpy as np


def window_around(mask: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the image that hold a mask (H, W), not empty, and `margin` pixels around it."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return (
        slice(max(0, rows[0] - margin), rows[-1] + 1 + margin),
        slice(max(0, columns[0] - margin), columns[-1] + 1 + margin),
    )
