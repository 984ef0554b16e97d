"""Which places the frames of a result show to be empty. Knows depth images; nothing of objects or formats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from perception.camera import invert_rigid, transform
from perception.frame import Frame

CLEAR = 0.003
"""A place is empty where what is seen on its ray is further than it by more than this [m]: sensors err by as
much."""


def seen_free(points: np.ndarray, frames: Sequence[Frame]) -> np.ndarray:
    """Which of points (N, 3) [m, world frame] lie before what any of the frames measured: (N,) bool."""
    free = np.zeros(len(points), bool)
    for frame in frames:
        camera = frame.camera
        local = transform(invert_rigid(camera.T_world_camera), np.asarray(points, float))
        ahead = np.flatnonzero(local[:, 2] > CLEAR)
        places, _ = camera.project(local[ahead])
        column, row = np.round(places).astype(int).T
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        seen = frame.depth[row[inside], column[inside]]
        # A comparison with NaN, where nothing was measured, is false.
        free[ahead[inside]] |= seen > local[ahead[inside], 2] + CLEAR
    return free
