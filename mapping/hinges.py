"""Where to put hinge points. Knows points and spacings; knows nothing of what the points are."""

from __future__ import annotations

import numpy as np


def lattice_in_box(low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
    """Points (H, d) float32 of the lattice of multiples of `spacing` inside a box, its borders included."""
    axes = [
        spacing * np.arange(np.ceil(a / spacing - 1e-6), np.floor(b / spacing + 1e-6) + 1)
        for a, b in zip(low, high)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes)).astype(np.float32)


def grid_around(X: np.ndarray, spacing: float) -> np.ndarray:
    """A grid (H, d) float32 that covers the box of points X (N, d), starting at its lower corner."""
    axes = [np.arange(low, high + spacing, spacing) for low, high in zip(X.min(0), X.max(0))]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, X.shape[1]).astype(np.float32)


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
    axes = np.ascontiguousarray(points.T)  # axis by axis: NumPy is slow at rows of three
    cells = np.rint(axes / spacing).astype(np.int32)
    low = cells.min(1) - steps
    held = np.zeros(cells.max(1) - low + steps + 1, bool)
    held[tuple(cells - low[:, None])] = True
    if steps > 0:  # spread from each cell that holds points; the margin of `steps` keeps it in the box
        flat = held.reshape(-1)
        flat[np.flatnonzero(flat)[:, None] + _ball(distance / spacing, held.shape)] = True
    return ((np.argwhere(held) + low) * spacing).astype(np.float32)


def _ball(radius: float, shape: tuple[int, ...]) -> np.ndarray:
    """Offsets (B,) of the cells within `radius` [cells] of a cell, counted in a flat array of `shape`."""
    steps = int(np.ceil(radius))
    offsets = np.stack(np.meshgrid(*[np.arange(-steps, steps + 1)] * len(shape), indexing="ij"))
    within = (offsets**2).sum(0) <= radius**2
    strides = np.cumprod((1, *shape[:0:-1]))[::-1]
    return strides @ offsets[:, within]


def random_subset(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """At most `count` of the points (N, d), drawn without replacement."""
    if len(points) <= count:
        return points
    return points[np.sort(rng.choice(len(points), count, replace=False))]
