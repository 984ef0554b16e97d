"""Hinge points on sparse lattices of several shapes, found by hashing.

Knows lattices and their nodes; must not know samples, classes or weights. Memory goes with the hinge points
there are, not with the box around them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.distinct import distinct
from mapping.kernels import cell_numbers

BITS = 2
SIDE = 1 << BITS
"""Hinge points are kept in cubes of this many nodes a side: one is looked up for all of them, and where there
are none, none of its nodes is."""


def _along() -> np.ndarray:
    """(3, SIDE + 1, SIDE + 1) int64: the bits of a cube's nodes that lie from a to b along an axis."""
    place = np.stack(np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij")).reshape(3, -1)
    bits = np.uint64(1) << np.arange(SIDE**3, dtype=np.uint64)
    out = np.zeros((3, SIDE + 1, SIDE + 1), np.uint64)
    for axis, a, b in np.ndindex(*out.shape):
        out[axis, a, b] = bits[(place[axis] >= a) & (place[axis] < b)].sum()
    return out.view(np.int64)


ALONG = _along()


class HashedHinges(NamedTuple):
    """Hinge points at nodes of lattices, T shapes of H points in all.

    spacings: (T, 3) distance of the nodes along each axis [m]; nodes: (H, 3) int32, the points' coordinates
    in spacings; first: (T + 1,) where each shape's points begin; amplitude: (T,) float32, factor of each
    shape's features; corners: (L, 3) int32, cubes that hold hinge points, in sides; cubes: (L, SIDE^3) int32,
    the hinge point at each of a cube's nodes, or -1; filled: (L,) int64, a bit for each node that has one;
    table: int32 open-addressed hash tables of the cubes of
    every shape, or -1; table_first: (T + 1,) where each begins, sizes being powers of two; width: float32,
    gamma times the squared spacing; cutoff: float32, features below are dropped.
    """

    spacings: np.ndarray
    nodes: np.ndarray
    first: np.ndarray
    amplitude: np.ndarray
    corners: np.ndarray
    cubes: np.ndarray
    filled: np.ndarray
    table: np.ndarray
    table_first: np.ndarray
    width: np.float32
    cutoff: np.float32


def filled_nodes(X: np.ndarray, spacing: np.ndarray | float) -> np.ndarray:
    """Lattice nodes (M, d) int64 that are the nearest one of any point (N, d), in spacings."""
    node = np.rint(X / spacing).astype(np.int64)
    number = cell_numbers(node - node.min(0))
    first, _ = distinct(number)
    return node[first[np.argsort(number[first])]]


def cube_by_cube(nodes: np.ndarray) -> np.ndarray:
    """Nodes (n, 3) in an order in which those of a cube follow each other: their weights lie side by side."""
    cube = nodes >> BITS
    return nodes[np.argsort(cell_numbers(cube - cube.min(0)), kind="stable")]


def hinges_at(
    nodes: Sequence[np.ndarray], spacings: np.ndarray, amplitude: np.ndarray, width: float, cutoff: float
) -> HashedHinges:
    """Hinge points at the nodes (n, 3) of each lattice; spacings (T, 3) [m], amplitude (T,)."""
    first = np.append(0, np.cumsum([len(part) for part in nodes]))
    every = np.concatenate(nodes).astype(np.int32)
    corners, cube_of = np.empty((len(every), 3), np.int32), np.empty(len(every), np.int32)
    tables, count = [], 0
    for t in range(len(nodes)):
        own = slice(first[t], first[t + 1])
        before, count = count, _enter(every[own], _table(len(nodes[t])), corners, cube_of[own], count)
        # Anew in a table for the cubes there are: a small one stays in the processor's cache.
        tables.append(_table(count - before))
        _enter(every[own], tables[-1], corners, cube_of[own], before)
    cubes = np.full((count, SIDE**3), -1, np.int32)
    within = every & (SIDE - 1)
    cubes[cube_of, (within[:, 0] * SIDE + within[:, 1]) * SIDE + within[:, 2]] = np.arange(len(every))
    return HashedHinges(
        np.asarray(spacings, np.float64),
        every,
        first,
        np.asarray(amplitude, np.float32),
        corners[:count].copy(),
        cubes,
        np.packbits(cubes >= 0, axis=1, bitorder="little").view("<i8")[:, 0].astype(np.int64),
        np.concatenate(tables),
        np.append(0, np.cumsum([len(table) for table in tables])),
        np.float32(width),
        np.float32(cutoff),
    )


def _table(count: int) -> np.ndarray:
    """An empty hash table for `count` cubes, at most half full."""
    return np.full(2 << max(count - 1, 1).bit_length(), -1, np.int32)


@compiled
def _slot(x: int, y: int, z: int, size: int) -> int:
    """Where a cube is looked for first in a table of `size`, a power of two."""
    key = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
    key ^= key >> 15
    return (key * 2654435761 >> 7) & (size - 1)


@compiled
def _enter(nodes: np.ndarray, table: np.ndarray, corners: np.ndarray, cube_of: np.ndarray, count: int) -> int:
    """Put the cubes of a shape's nodes (n, 3) into its table and behind the `count` that are in corners: how
    many there are then. Fills each node's cube (n,)."""
    for i in range(len(nodes)):
        x, y, z = (
            np.int64(nodes[i, 0] >> BITS),
            np.int64(nodes[i, 1] >> BITS),
            np.int64(nodes[i, 2] >> BITS),
        )
        at = _slot(x, y, z, len(table))
        while True:
            cube = table[at]
            if cube < 0:
                table[at] = cube = count
                corners[cube, 0], corners[cube, 1], corners[cube, 2] = x, y, z
                count += 1
            if corners[cube, 0] == x and corners[cube, 1] == y and corners[cube, 2] == z:
                break
            at = (at + 1) & (len(table) - 1)
        cube_of[i] = cube
    return count


@compiled
def cube_at(x: int, y: int, z: int, t: int, hinges: HashedHinges) -> int:
    """The cube of shape t at a corner, in sides; -1 where none is."""
    start = hinges.table_first[t]
    mask = hinges.table_first[t + 1] - start - 1
    at = _slot(x, y, z, mask + 1)
    while True:
        i = hinges.table[start + at]
        if i < 0 or (hinges.corners[i, 0] == x and hinges.corners[i, 1] == y and hinges.corners[i, 2] == z):
            return i
        at = (at + 1) & mask


@compiled
def hinge_at(x: int, y: int, z: int, t: int, hinges: HashedHinges) -> int:
    """The hinge point of shape t at a node; -1 where none is."""
    cube = cube_at(x >> BITS, y >> BITS, z >> BITS, t, hinges)
    if cube < 0:
        return -1
    return hinges.cubes[cube, ((x & (SIDE - 1)) * SIDE + (y & (SIDE - 1))) * SIDE + (z & (SIDE - 1))]
