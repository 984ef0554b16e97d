"""Sampling primitives for contrastive maps: rays from an origin to surface points, voxels, noise.

Knows points, rays and boxes in R^d; knows nothing of cameras, labels or objects.
"""

from __future__ import annotations

import numpy as np


def voxel_subsample(points: np.ndarray, size: float, rng: np.random.Generator | None = None) -> np.ndarray:
    """Indices (M,) of one point a voxel of `size`: the first one, or a random one when `rng` is given."""
    if len(points) == 0:
        return np.empty(0, np.int64)
    cell = np.floor((points - points.min(0)) / size).astype(np.int64)
    key = np.ravel_multi_index(tuple(cell.T), tuple(cell.max(0) + 1))
    if rng is None:
        return np.sort(np.unique(key, return_index=True)[1])
    shuffled = rng.permutation(len(points))
    return np.sort(shuffled[np.unique(key[shuffled], return_index=True)[1]])


def shift_along_rays(origin: np.ndarray, points: np.ndarray, distance: float) -> np.ndarray:
    """Points (N, d) moved by `distance` away from the origin (d,) along their rays; negative comes nearer."""
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
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in count], indexing="ij"), -1)
    cells = cells.reshape(-1, len(count))
    return (low + (cells + rng.random(cells.shape)) * spacing).astype(np.float32)


def jittered(points: np.ndarray, spacing: float, rng: np.random.Generator) -> np.ndarray:
    """Lattice points (N, d) moved at random within their cells of `spacing`."""
    return (points + spacing * (rng.random(points.shape) - 0.5)).astype(np.float32)


def within(points: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """Mask (N,): points (N, d) within `radius` of any centre (M, d)."""
    near = np.zeros(len(points), bool)
    axes = np.ascontiguousarray(points.T)  # axis by axis: NumPy is slow at sums over a few numbers a row
    for centre in centres.astype(points.dtype):
        near |= sum((axis - middle) ** 2 for axis, middle in zip(axes, centre)) <= radius**2
    return near
