"""Sampling primitives for contrastive maps: rays from an origin to surface points, voxels, noise.

Knows points, rays and boxes in R^d; knows nothing of cameras, labels or objects.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

LARGEST_TABLE = 8
"""Samples are sorted by their cells when there are more cells than this a sample, else put in a table."""


def voxel_subsample(points: np.ndarray, size: float, rng: np.random.Generator | None = None) -> np.ndarray:
    """Indices (M,) of one point a voxel of `size`: the first one, or a random one when `rng` is given."""
    if len(points) == 0:
        return np.empty(0, np.int64)
    axes = np.ascontiguousarray(points.T)  # axis by axis: NumPy is slow at rows of three
    cells = np.floor((axes - axes.min(1, keepdims=True)) / size).astype(np.int64)
    extent = cells.max(1) + 1
    key = np.ravel_multi_index(tuple(cells), tuple(extent))
    order = np.arange(len(points)) if rng is None else rng.permutation(len(points))
    if np.prod(extent, dtype=float) > LARGEST_TABLE * len(points):
        return np.sort(order[np.unique(key[order], return_index=True)[1]])
    first = np.full(np.prod(extent), -1)
    first[key[order[::-1]]] = order[::-1]  # of points in one voxel, the last to be written stays
    return np.sort(first[first >= 0])


def merge_in_cells(
    points: np.ndarray, classes: np.ndarray, weights: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One weighted sample for all of a class in a cubic cell between multiples of `size`: at their mean, with
    their sum.

    points: (N, d); classes: (N,) int >= 0; weights: (N,) > 0. Returns points (M, d) float64, classes (M,) and
    weights (M,), M <= N. The weighted sum of a function over the samples changes only by its curvature within
    a cell: an error of second order in the size over the function's length scale.
    """
    if len(points) == 0:
        return np.empty(points.shape), np.empty(0, np.int64), np.empty(0)
    # Cells lie in space, not from the first point on: parts and wholes have the same samples.
    cells = [np.floor(axis / size) for axis in points.T]
    cells = [(cell - cell.min()).astype(np.int32) for cell in cells]
    extent = [int(classes.max()) + 1, *(int(cell.max()) + 1 for cell in cells)]
    key = np.ravel_multi_index((classes, *cells), extent)
    if np.prod(extent, dtype=float) > LARGEST_TABLE * len(points):
        filled, key = np.unique(key, return_inverse=True)
        chosen = np.arange(len(filled))
    else:  # counting in a table is several times faster than sorting
        filled = chosen = np.flatnonzero(np.bincount(key))
    total = np.bincount(key, weights)[chosen]
    sums = [np.bincount(key, weights * axis)[chosen] for axis in points.T]
    return np.stack(sums, axis=1) / total[:, None], filled // np.prod(extent[1:]), total


def shift_along_rays(origin: np.ndarray, points: np.ndarray, distance: float) -> np.ndarray:
    """Points (N, d) moved by `distance` away from an origin (d,), or one each (N, d); negative: nearer."""
    rays = points - origin
    return points + distance * rays / np.linalg.norm(rays, axis=1, keepdims=True)


def along_rays(
    origin: np.ndarray, points: np.ndarray, step: float, margin: float, rng: np.random.Generator
) -> np.ndarray:
    """Stratified samples (M, d) in the open space between an origin (d,) and points (N, d).

    One uniform sample in each `step` of every ray, kept where more than `margin` before the ray's end.
    """
    rays = points - origin
    length = np.linalg.norm(rays, axis=1)
    count = int(np.ceil(length.max() / step))
    distance = rng.random((len(points), count))
    distance += np.arange(count)
    distance *= step
    kept = distance < (length - margin)[:, None]
    ray = np.repeat(np.arange(len(points)), kept.sum(1))
    share = (distance[kept] / length[ray]).astype(points.dtype)
    return origin.astype(points.dtype) + rays[ray] * share[:, None]


def jittered_lattice(
    low: np.ndarray, high: np.ndarray, spacing: float, rng: np.random.Generator
) -> np.ndarray:
    """One uniform sample (M, d) float32 in each cell of `spacing` that fills the box: even, without a grid's
    regularity."""
    count = np.maximum(np.ceil((high - low) / spacing).astype(int), 1)
    points = rng.random((*count, len(count)), np.float32)
    for axis, steps in enumerate(np.ogrid[tuple(slice(n) for n in count)]):
        points[..., axis] += steps
    points *= np.float32(spacing)
    points += low.astype(np.float32)
    return points.reshape(-1, len(count))


def jittered(points: np.ndarray, spacing: float, rng: np.random.Generator) -> np.ndarray:
    """Lattice points (N, d) moved at random within their cells of `spacing`."""
    return (points + spacing * (rng.random(points.shape) - 0.5)).astype(np.float32)


@compiled
def within(points: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """Mask (N,): points (N, d) within `radius` of any centre (M, d)."""
    near = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        for centre in range(len(centres)):
            square = np.float32(0)
            for axis in range(points.shape[1]):
                square += np.float32(points[i, axis] - centres[centre, axis]) ** 2
            if square <= radius**2:
                near[i] = True
                break
    return near
