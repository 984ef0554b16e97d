"""Where to put hinge points. Knows points and spacings; knows nothing of what the points are."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


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
    if not len(points):
        return np.empty(points.shape, np.float32)
    steps = int(np.ceil(distance / spacing))
    cells, low, high = _cells(np.ascontiguousarray(points), points.dtype.type(spacing))
    low -= steps  # room to spread from each cell that holds points
    shape = high - low + steps + 1
    held = np.zeros(int(np.prod(shape)), bool)
    offsets = _ball(distance / spacing, tuple(shape))
    return np.asarray(_nodes(_spread(cells, low, shape, offsets, held), low, shape, spacing))


@compiled
def _cells(points: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest multiple of `spacing` to each of points (N, d), counted in it (N, d), and the least and the
    greatest of them along each axis (d,)."""
    cells = np.empty(points.shape, np.int32)
    flat, coordinates = cells.reshape(-1), points.reshape(-1)
    for i in range(len(flat)):  # one row after the other: so it becomes vectors
        flat[i] = np.int32(np.rint(coordinates[i] / spacing))
    low, high = np.empty(points.shape[1], np.int64), np.empty(points.shape[1], np.int64)
    for axis in range(points.shape[1]):
        least = most = cells[0, axis]
        for i in range(len(points)):
            least, most = min(least, cells[i, axis]), max(most, cells[i, axis])
        low[axis], high[axis] = least, most
    return cells, low, high


@compiled
def _spread(
    cells: np.ndarray, low: np.ndarray, shape: np.ndarray, offsets: np.ndarray, held: np.ndarray
) -> np.ndarray:
    """Which cells of a box of a shape (d,) from `low` on, held (M,) bool, are at some of `offsets` (B,) from
    one of cells (N, d)."""
    filled = np.zeros(len(held), np.bool_)
    for i in range(len(cells)):
        flat = 0
        for axis in range(len(low)):
            flat = flat * shape[axis] + cells[i, axis] - low[axis]
        filled[flat] = True
    for flat in range(len(filled)):
        if filled[flat]:
            for offset in offsets:
                held[flat + offset] = True
    return held


@compiled
def _nodes(held: np.ndarray, low: np.ndarray, shape: np.ndarray, spacing: float) -> np.ndarray:
    """Places (H, d) of the cells that are held, in their order."""
    found = np.flatnonzero(held)
    nodes = np.empty((len(found), len(low)), np.float32)
    for i in range(len(found)):
        flat = found[i]
        for axis in range(len(low) - 1, -1, -1):
            nodes[i, axis] = (flat % shape[axis] + low[axis]) * spacing
            flat //= shape[axis]
    return nodes


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
