"""Gaussian features of hinge points that lie on sparse lattices of several shapes, found by hashing.

Knows points in space, lattices and weights; must not know samples' classes or how weights are found. Memory
goes with the hinge points there are, not with the box around them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.kernels import cell_numbers, reach
from mapping.threads import map_in_threads

ROWS = 2**14
"""Points that a thread works on at a time."""
BLOCK = 2.0
"""Points in a cube of this side [m] follow each other, and in it those in one cell of the finest lattice."""


class HashedHinges(NamedTuple):
    """Hinge points at nodes of lattices, T shapes of H points in all.

    spacings: (T, 3) distance of the nodes along each axis [m]; nodes: (H, 3) int32, the points' coordinates
    in spacings; first: (T + 1,) where each shape's points begin; amplitude: (T,) float32, factor of each
    shape's features; table: int32 open-addressed hash tables of all shapes, indices into nodes or -1;
    table_first: (T + 1,) where each begins, sizes being powers of two; steps: (M, 3) int32 from the nearest
    node to all that may be in reach; width: float32, gamma times the squared spacing; cutoff: float32,
    features below are dropped; near_first (H + 1,), near and near_step (nnz,): hinge points at these steps
    from each one, and the steps.
    """

    spacings: np.ndarray
    nodes: np.ndarray
    first: np.ndarray
    amplitude: np.ndarray
    table: np.ndarray
    table_first: np.ndarray
    steps: np.ndarray
    width: np.float32
    cutoff: np.float32
    near_first: np.ndarray
    near: np.ndarray
    near_step: np.ndarray


def filled_nodes(X: np.ndarray, spacing: np.ndarray | float) -> np.ndarray:
    """Lattice nodes (M, d) int64 that are the nearest one of any point (N, d), in spacings."""
    node = np.rint(X / spacing).astype(np.int64)
    _, first = np.unique(cell_numbers(node - node.min(0)), return_index=True)
    return node[first]


def hinges_at(
    nodes: Sequence[np.ndarray], spacings: np.ndarray, amplitude: np.ndarray, width: float, cutoff: float
) -> HashedHinges:
    """Hinge points at the nodes (n, 3) of each lattice; spacings (T, 3) [m], amplitude (T,)."""
    sizes = np.array([2 << max(len(part) - 1, 1).bit_length() for part in nodes])
    table_first = np.append(0, np.cumsum(sizes))
    first = np.append(0, np.cumsum([len(part) for part in nodes]))
    every = np.concatenate(nodes).astype(np.int32)
    table = np.full(table_first[-1], -1, np.int32)
    for t in range(len(nodes)):
        _enter(table[table_first[t] : table_first[t + 1]], every, first[t], first[t + 1])
    radius = float(reach(width, cutoff))
    rim = int(np.floor(radius + 0.5))
    steps = np.stack(np.meshgrid(*[np.arange(-rim, rim + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    gap = np.maximum(np.abs(steps) - 0.5, 0)
    steps = steps[(gap**2).sum(1) <= radius**2]
    hinges = HashedHinges(
        np.asarray(spacings, np.float64),
        every,
        first,
        np.asarray(amplitude, np.float32),
        table,
        table_first,
        steps.astype(np.int32),
        np.float32(width),
        np.float32(cutoff),
        np.empty(0, np.int64),
        np.empty(0, np.int32),
        np.empty(0, np.uint8),
    )
    near_first, near, near_step = _neighbours(hinges)
    return hinges._replace(near_first=near_first, near=near, near_step=near_step)


def order_of(X: np.ndarray, hinges: HashedHinges) -> np.ndarray:
    """(N,) order in which points (N, 3) that share hinge points follow each other."""
    finest = hinges.spacings[np.argmin(hinges.spacings.prod(axis=1))]
    block = np.floor(X / BLOCK)
    cell = np.rint(X / finest)
    keys = cell_numbers(block - block.min(0)), cell_numbers(cell - cell.min(0))
    return np.lexsort(keys[::-1])


def features_at(X: np.ndarray, hinges: HashedHinges) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Features of points (N, 3) as sparse rows: ends (N + 1,) int32, columns (nnz,), values (nnz,) float32
    times their amplitude, and the strongest feature of each row (N,) without it."""
    parts = _in_parts(X, lambda part: _features(part, hinges))
    lengths, columns, values, strongest = (np.concatenate(arrays) for arrays in zip(*parts))
    return np.append(0, np.cumsum(lengths)).astype(np.int32), columns, values, strongest


def logits_at(X: np.ndarray, hinges: HashedHinges, W: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """offset (C,) + features times amplitude times W (H, C), at points (N, 3): (N, C) float32."""
    out = np.empty((len(X), len(offset)), np.float32)
    order = order_of(X, hinges) if len(X) else np.empty(0, np.int64)
    parts = _in_parts(X[order], lambda part: _logits(part, hinges, W, offset))
    out[order] = np.concatenate(parts) if parts else out
    return out


def _in_parts(X: np.ndarray, function: Callable[[np.ndarray], Any]) -> list[Any]:
    X = np.ascontiguousarray(X, np.float64)
    return map_in_threads(function, [X[a : a + ROWS] for a in range(0, len(X), ROWS)])


@compiled
def _slot(x: int, y: int, z: int, size: int) -> int:
    """Where a node is looked for first in a table of `size`, a power of two."""
    key = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    key ^= key >> 15
    return (key * 2654435761 >> 7) & (size - 1)


@compiled
def _enter(table: np.ndarray, nodes: np.ndarray, start: int, stop: int) -> None:
    """Put nodes start..stop into their shape's table."""
    for i in range(start, stop):
        at = _slot(np.int64(nodes[i, 0]), np.int64(nodes[i, 1]), np.int64(nodes[i, 2]), len(table))
        while table[at] >= 0:
            at = (at + 1) & (len(table) - 1)
        table[at] = i


@compiled
def _find(x: int, y: int, z: int, t: int, hinges: HashedHinges) -> int:
    """The hinge point of shape t at a node, -1 where none is."""
    start = hinges.table_first[t]
    mask = hinges.table_first[t + 1] - start - 1
    at = _slot(x, y, z, mask + 1)
    while True:
        i = hinges.table[start + at]
        if i < 0 or (hinges.nodes[i, 0] == x and hinges.nodes[i, 1] == y and hinges.nodes[i, 2] == z):
            return i
        at = (at + 1) & mask


@compiled
def _search(node: np.ndarray, t: int, hinges: HashedHinges, found: np.ndarray, step_of: np.ndarray) -> int:
    """How many hinge points of shape t lie at `steps` from a node (3,): indices and steps fill the arrays."""
    count = 0
    for m in range(len(hinges.steps)):
        steps = hinges.steps[m]
        i = _find(node[0] + steps[0], node[1] + steps[1], node[2] + steps[2], t, hinges)
        if i >= 0:
            found[count], step_of[count] = i, m
            count += 1
    return count


@compiled
def _neighbours(hinges: HashedHinges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `_search` finds from every hinge point's own node: first (H + 1,), indices and steps."""
    most = len(hinges.steps)
    found, step_of = np.empty(most, np.int32), np.empty(most, np.uint8)
    near, near_step = np.empty(most * 64, np.int32), np.empty(most * 64, np.uint8)
    first, node, total = np.zeros(len(hinges.nodes) + 1, np.int64), np.empty(3, np.int64), 0
    for t in range(len(hinges.spacings)):
        for i in range(hinges.first[t], hinges.first[t + 1]):
            node[:] = hinges.nodes[i]
            count = _search(node, t, hinges, found, step_of)
            if total + count > len(near):
                near = np.concatenate((near, np.empty(len(near), np.int32)))
                near_step = np.concatenate((near_step, np.empty(len(near_step), np.uint8)))
            near[total : total + count] = found[:count]
            near_step[total : total + count] = step_of[:count]
            total += count
            first[i + 1] = total
    return first, near[:total].copy(), near_step[:total].copy()


@compiled
def _along_axes(
    point: np.ndarray, node: np.ndarray, spacing: np.ndarray, width: float, out: np.ndarray
) -> None:
    """exp(-width (d - r)^2) along each axis, out (3, 2 rim + 1), at r = -rim..rim spacings from the node."""
    rim, once = out.shape[1] // 2, np.exp(-2 * width)
    for axis in range(3):
        d = np.float32(point[axis] / spacing[axis] - node[axis])
        # Each is its neighbour times a ratio that falls by the same factor a step.
        up = np.exp(width * (2 * d - 1))
        down = once / up
        out[axis, rim] = np.exp(-width * d * d)
        for r in range(1, rim + 1):
            out[axis, rim + r] = out[axis, rim + r - 1] * up
            out[axis, rim - r] = out[axis, rim - r + 1] * down
            up *= once
            down *= once


@compiled
def _pairs(
    point: np.ndarray,
    t: int,
    hinges: HashedHinges,
    node: np.ndarray,
    along: np.ndarray,
    index: np.ndarray,
    value: np.ndarray,
) -> int:
    """How many hinge points of shape t are in reach of a point (3,): indices and features fill the arrays.

    node (3,) and along (3, 2 rim + 1) are room to work in.
    """
    rim, count = along.shape[1] // 2, 0
    for axis in range(3):
        node[axis] = np.int64(np.rint(point[axis] / hinges.spacings[t, axis]))
    own = _find(node[0], node[1], node[2], t, hinges)
    _along_axes(point, node, hinges.spacings[t], hinges.width, along)
    if own < 0:
        # Away from data most steps are too long, or lead nowhere.
        for m in range(len(hinges.steps)):
            x, y, z = hinges.steps[m, 0], hinges.steps[m, 1], hinges.steps[m, 2]
            feature = along[0, x + rim] * along[1, y + rim] * along[2, z + rim]
            if feature > hinges.cutoff:
                i = _find(node[0] + x, node[1] + y, node[2] + z, t, hinges)
                if i >= 0:
                    index[count], value[count] = i, feature
                    count += 1
        return count
    for k in range(hinges.near_first[own], hinges.near_first[own + 1]):
        steps = hinges.steps[hinges.near_step[k]]
        feature = along[0, steps[0] + rim] * along[1, steps[1] + rim] * along[2, steps[2] + rim]
        # Written in any case, and written over unless it counts: a branch costs more.
        index[count], value[count] = hinges.near[k], feature
        count += feature > hinges.cutoff
    return count


@compiled
def _features(X: np.ndarray, hinges: HashedHinges) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Lengths (n,), columns, values and strongest (n,) of the rows of points (n, 3)."""
    shapes, most, rim = len(hinges.spacings), len(hinges.steps), np.max(hinges.steps)
    index, value = np.empty(most + 1, np.int32), np.empty(most + 1, np.float32)
    node, along = np.empty(3, np.int64), np.empty((3, 2 * rim + 1), np.float32)
    lengths, strongest = np.zeros(len(X), np.int64), np.zeros(len(X), np.float32)
    columns = np.empty(shapes * (most + 16 * len(X)), np.int32)
    values = np.empty(len(columns), np.float32)
    total = 0
    for i in range(len(X)):
        if total + shapes * most > len(columns):
            more = len(columns) + shapes * most
            columns = np.concatenate((columns, np.empty(more, np.int32)))
            values = np.concatenate((values, np.empty(more, np.float32)))
        before = total
        for t in range(shapes):
            for k in range(_pairs(X[i], t, hinges, node, along, index, value)):
                columns[total], values[total] = index[k], value[k] * hinges.amplitude[t]
                strongest[i] = max(strongest[i], value[k])
                total += 1
        lengths[i] = total - before
    return lengths, columns[:total].copy(), values[:total].copy(), strongest


@compiled
def _logits(X: np.ndarray, hinges: HashedHinges, W: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Logits (n, C) at points (n, 3)."""
    shapes, most, rim = len(hinges.spacings), len(hinges.steps), np.max(hinges.steps)
    index, value = np.empty(most + 1, np.int32), np.empty(most + 1, np.float32)
    node, along = np.empty(3, np.int64), np.empty((3, 2 * rim + 1), np.float32)
    out = np.empty((len(X), len(offset)), np.float32)
    for i in range(len(X)):
        out[i] = offset
        for t in range(shapes):
            for k in range(_pairs(X[i], t, hinges, node, along, index, value)):
                feature, hinge = value[k] * hinges.amplitude[t], index[k]
                for c in range(out.shape[1]):
                    out[i, c] += feature * W[hinge, c]
    return out
