"""Where to put hinge points. Knows points and spacings; knows nothing of what the points are."""

from __future__ import annotations

import numpy as np
from scipy import ndimage


def lattice_in_box(low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
    """Points (H, d) float32 of the lattice of multiples of `spacing` inside a box, its borders included."""
    axes = [
        spacing * np.arange(np.ceil(a / spacing - 1e-6), np.floor(b / spacing + 1e-6) + 1)
        for a, b in zip(low, high)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes)).astype(np.float32)


def lattice_near_centres(centres: np.ndarray, radius: float, spacing: float) -> np.ndarray:
    """Lattice points (H, d) within `radius` of any centre (M, d)."""
    lattice = lattice_in_box(centres.min(0) - radius, centres.max(0) + radius, spacing)
    near = np.zeros(len(lattice), bool)
    for centre in centres.astype(np.float32):
        # A micrometre of slack: float32 must not decide about points exactly on the sphere.
        near |= ((lattice - centre) ** 2).sum(1) <= (radius + 1e-6) ** 2
    return lattice[near]


def lattice_near_points(points: np.ndarray, distance: float, spacing: float) -> np.ndarray:
    """Lattice points (H, d) float32 within about `distance` of any of many points (N, d).

    Works on the lattice cells that hold points, so the cost does not grow with pairs.
    """
    steps = int(np.ceil(distance / spacing))
    cell = np.rint(points / spacing).astype(np.int64)
    low = cell.min(0) - steps
    occupied = np.zeros(cell.max(0) - low + steps + 1, bool)
    occupied[tuple((cell - low).T)] = True
    away = ndimage.distance_transform_edt(~occupied, sampling=spacing)
    return ((np.argwhere(away <= distance) + low) * spacing).astype(np.float32)


def random_subset(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """At most `count` of the points (N, d), drawn without replacement."""
    if len(points) <= count:
        return points
    return points[np.sort(rng.choice(len(points), count, replace=False))]
