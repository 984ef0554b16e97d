"""Truncated kernel features of samples in tiles of eight, for fitting on a processor.

Knows points, hinge points and widths; knows nothing of classes, weights' meaning or fitting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.compact_order import compact_order
from mapping.compiled import compiled
from mapping.hinge_nodes import HingeNodes
from mapping.lanes import (
    LANES,
    above,
    every,
    exponential,
    highest,
    larger,
    load,
    minus,
    plus_product,
    store,
    times,
)
from mapping.sparse_features import sparse_features
from mapping.threads import Threads, map_in_threads
from mapping.tiles import Tiles, tiles_of

SHARED_FROM = 512
"""Tiles from which on threads share them."""
FAR = np.float32(1e9)
"""Where places of a tile that has fewer than eight points are put: out of reach, in any unit."""


@dataclass(frozen=True)
class TiledFeatures:
    """Features of N samples in shares, at least one a thread, each of some tiles that follow each other.

    order: (N,) the row's index in the caller's array; strongest: (N,) largest feature of each row;
    hinge_count: columns, one a hinge point; nodes: these on their lattices, None where they lie on none.
    """

    order: np.ndarray
    strongest: np.ndarray
    shares: list[Tiles]
    hinge_count: int
    nodes: HingeNodes | None = None


def tiled_features(X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> TiledFeatures:
    """Truncated features of X (N, d); each row keeps the hinge points whose feature exceeds `cutoff`."""
    order = compact_order(X, LANES)
    nodes = HingeNodes.of(hinges, gamma, cutoff)
    if nodes is None:
        return _of_search(X, hinges, gamma, cutoff, order)
    points = points_of_tiles(X[order])
    found = map_in_threads(
        lambda part: in_reach(points[part], nodes, np.float32(cutoff)), _parts(len(points))
    )
    strongest = np.concatenate([values for _, values in found])[: len(X)]
    return TiledFeatures(order, strongest, [tiles for tiles, _ in found], len(hinges), nodes)


def points_of_tiles(X: np.ndarray) -> np.ndarray:
    """Points (N, d) eight a tile: (T, 3, 8), each coordinate's eight numbers one after the other."""
    points = np.zeros((-(-len(X) // LANES) * LANES, 3), np.float32)
    points[: len(X), : X.shape[1]] = X
    points[len(X) :] = FAR
    return np.ascontiguousarray(points.reshape(-1, LANES, 3).transpose(0, 2, 1))


def tiles_of_rows(ends: np.ndarray, columns: np.ndarray, values: np.ndarray, width: int) -> list[Tiles]:
    """Shares of tiles, as in `TiledFeatures`, of rows in a compact order, `width` columns in all: row i has
    columns[ends[i] : ends[i + 1]] and their values."""
    ends, columns = ends.astype(np.int64), columns.astype(np.int32)

    def tiles(part: slice) -> Tiles:
        return tiles_of(ends[part.start * LANES : part.stop * LANES + 1], columns, values, width)

    return map_in_threads(tiles, _parts(-(-(len(ends) - 1) // LANES)))


def _parts(tiles: int) -> list[slice]:
    # Few samples are one share for any number of threads: handing them over costs more than it wins.
    return Threads().split(tiles) if tiles >= SHARED_FROM else [slice(0, tiles)]


def _of_search(
    X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray, cutoff: float, order: np.ndarray
) -> TiledFeatures:
    """The same for hinge points that lie on no lattices."""
    from scipy import sparse  # here, since it would add to the cost of importing the map

    found = sparse_features(X[order], hinges, gamma, cutoff, torch.device("cpu"))
    ends = np.append(found.rows.offsets.numpy(), np.int32(len(found.rows.values)))
    parts = found.rows.values.numpy(), found.rows.columns.numpy(), ends
    back = np.argsort(found.order.numpy())
    rows = sparse.csr_matrix(parts, (len(X), len(hinges)))[back]
    shares = tiles_of_rows(rows.indptr, rows.indices, rows.data, len(hinges))
    return TiledFeatures(order, found.strongest.numpy()[back], shares, len(hinges))


@compiled
def in_reach(points: np.ndarray, nodes: HingeNodes, cutoff: float) -> tuple[Tiles, np.ndarray]:
    """Tiles of points (T, 3, 8), and the largest feature of each of them (8 T,); those below `cutoff` do not
    count."""
    ids, first, shape, low, spacing, gamma = nodes
    coordinates, zero, least = points.reshape(-1), every(np.float32(0)), every(cutoff)
    starts, strongest = np.zeros(len(points) + 1, np.int64), np.empty(len(points) * LANES, np.float32)
    columns = np.empty(64 * len(points) + 1024, np.int32)
    values = np.empty(LANES * len(columns), np.float32)
    begin, end, found = np.zeros(3, np.int64), np.zeros(3, np.int64), 0
    for p in range(len(points)):
        x, y = load(coordinates, p * 3 * LANES), load(coordinates, (p * 3 + 1) * LANES)
        z, of_tile = load(coordinates, (p * 3 + 2) * LANES), zero
        for t in range(len(first)):
            radius = np.sqrt(-np.log(cutoff) / gamma[t])
            most = _nodes_around(points[p], t, nodes, radius, begin, end)
            if found + most > len(columns):
                more = len(columns) + most
                columns = np.concatenate((columns, np.empty(more, np.int32)))
                values = np.concatenate((values, np.empty(LANES * more, np.float32)))
            rate = every(-gamma[t])
            for i in range(begin[0], end[0]):
                from_x = minus(x, every(low[t, 0] + i * spacing[t, 0]))
                squared_x = times(from_x, from_x)
                for j in range(begin[1], end[1]):
                    from_y = minus(y, every(low[t, 1] + j * spacing[t, 1]))
                    squared_xy = plus_product(squared_x, from_y, from_y)
                    row = first[t] + (i * shape[t, 1] + j) * shape[t, 2]
                    for k in range(begin[2], end[2]):
                        hinge = ids[row + k]
                        if hinge < 0:
                            continue
                        from_z = minus(z, every(low[t, 2] + k * spacing[t, 2]))
                        squared = plus_product(squared_xy, from_z, from_z)
                        value = above(exponential(times(squared, rate)), least)
                        if highest(value) > 0:
                            columns[found] = hinge
                            store(values, LANES * found, value)
                            of_tile = larger(of_tile, value)
                            found += 1
        store(strongest, LANES * p, of_tile)
        starts[p + 1] = found
    return Tiles(starts, columns[:found].copy(), values[: LANES * found].copy()), strongest


@compiled
def _nodes_around(
    points: np.ndarray, t: int, nodes: HingeNodes, radius: float, begin: np.ndarray, end: np.ndarray
) -> int:
    """Nodes of a lattice that can be within `radius` of a tile's points (3, 8): how many, and from where to
    where along each axis."""
    most = 1
    for axis in range(3):
        smallest = largest = points[axis, 0]
        for place in points[axis]:
            smallest = min(smallest, place)
            largest = max(largest, place) if place < FAR else largest
        low, spacing = nodes.low[t, axis], nodes.spacing[t, axis]
        side = np.float32(nodes.shape[t, axis])
        below = np.ceil((smallest - radius - low) / spacing)
        beyond = np.floor((largest + radius - low) / spacing) + 1
        begin[axis] = np.int64(min(max(below, np.float32(0)), side))
        end[axis] = np.int64(min(max(beyond, np.float32(0)), side))
        most *= max(end[axis] - begin[axis], 0)
    return most
