"""What an object lies on that is no support: the lid of a pot, a box, a heap, seen all around it.

Knows what the pixels around an object's mask see; knows nothing of guesses or labels of samples.
"""

from __future__ import annotations

import numpy as np

from perception.camera import transform
from perception.observation import NOTHING, SUPPORT, Observation, ObservedObject

RING = (2, 6)
"""Pixels between these distances of an object's mask lie around it [px]; nearer ones are its rim."""
AROUND = 0.6
"""An object lies on one thing where more than this share of what is seen around it is that thing."""
IN_FRONT = 0.01
"""What is this much nearer to the camera than the object beside it hides it, and carries nothing [m]."""


def bed_height(observation: Observation, item: ObservedObject) -> float | None:
    """Height [m] in the table frame of the one thing that is seen around an object, below all that is seen
    of it: it lies on that. None where a support or several things are."""
    from scipy.ndimage import distance_transform_edt

    assert observation.seen is not None
    height, width = observation.depth.shape
    rows, columns = np.divmod(np.concatenate([item.pixels, item.silhouette]), width)
    top, left = max(rows.min() - RING[1], 0), max(columns.min() - RING[1], 0)
    window = np.s_[top : rows.max() + RING[1] + 1, left : columns.max() + RING[1] + 1]
    depth, seen = observation.depth[window], observation.seen[window]
    mask = np.zeros((height, width), bool)
    mask.reshape(-1)[item.pixels] = True
    measured = mask[window].copy()
    mask.reshape(-1)[item.silhouette] = True
    apart = distance_transform_edt(~mask[window])
    ring = (apart > RING[0]) & (apart <= RING[1]) & (seen != NOTHING)
    if not ring.any():
        return None
    kinds, count = np.unique(seen[ring], return_counts=True)
    kind = kinds[count.argmax()]
    if kind == SUPPORT or count.max() < AROUND * count.sum():
        return None
    nearest = distance_transform_edt(~measured, return_distances=False, return_indices=True)
    own = depth[nearest[0], nearest[1]]
    under = ring & (seen == kind) & (depth > own - IN_FRONT)
    if under.sum() < AROUND * count.sum():
        return None
    places = observation.camera.rays[window][under] * depth[under][:, None]
    found = float(np.median(transform(observation.T_table_camera, places)[:, 2]))
    return found if found < item.bounds[0][2] else None
