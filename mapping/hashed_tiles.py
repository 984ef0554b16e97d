"""Features of hashed hinge points for points in tiles of eight, to fit a map and to ask it.

Knows points, hinge points and weights; must not know samples' classes or how weights are found.

A Gaussian is a product over axes, and hinge points lie on lattices: a tile needs a few exponentials an axis,
and one product a hinge point for its eight points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mapping.compact_order import compact_order
from mapping.compiled import compiled
from mapping.hashed_hinges import ALONG, BITS, SIDE, HashedHinges, cube_at
from mapping.kernels import cell_numbers
from mapping.lanes import (
    LANES,
    above,
    any_above,
    every,
    exponential,
    highest,
    larger,
    load,
    lowest_bit,
    minus,
    plus_product,
    store,
    times,
)
from mapping.threads import Threads, map_in_threads
from mapping.tiled_features import TiledFeatures
from mapping.tiles import Tiles, answer_tiles, flat

ROWS = 2**13
"""Points that a thread works on at a time: whole tiles."""
BLOCK = 4.0
"""Points in a cube of this side [m] are worked on together."""
CELLS = 8
"""Points are counted in their blocks where there are at most so many blocks a point."""
SPREAD = 12
"""Points of a tile look for hinge points alone where the box around all that may be in reach holds more than
so many times the nodes that one of them has in reach, or is so many times as long."""


def features_in_tiles(X: np.ndarray, hinges: HashedHinges) -> TiledFeatures:
    """Features of points (N, 3), times their shape's amplitude; `strongest` is without it."""
    parts = map_in_threads(lambda rows: _compact_tiles(X, rows, hinges), _parts(_order_of(X)))
    orders, strongest = ([part[k] for part in parts] for k in (0, 2))
    # As few shares as there are threads: each has a derivative of its own. What is joined is let go.
    tiles, shares = [part[1] for part in parts], []
    del parts
    for some in reversed(Threads().split(len(tiles))):
        shares.append(_joined(tiles[some]))
        del tiles[some]
    shares.reverse()
    return TiledFeatures(np.concatenate(orders), np.concatenate(strongest), shares, int(hinges.first[-1]))


def shares_at(
    X: np.ndarray, hinges: HashedHinges, W: np.ndarray, offset: np.ndarray, columns: np.ndarray, count: int
) -> np.ndarray:
    """Softmax of offset (C,) + features times amplitude times W (H, C), at points (N, 3): class by class in
    columns (C,) of (N, count) float32, 0 in the others."""
    out, weights = np.zeros((len(X), count), np.float32), flat(W)

    def answer(rows: np.ndarray) -> None:
        order, tiles, _ = _compact_tiles(X, rows, hinges)
        answer_tiles(tiles, weights, offset, order, columns, out)

    map_in_threads(answer, _parts(_order_of(X)))
    return out


def _order_of(X: np.ndarray) -> np.ndarray:
    """Indices (N,) int32 of points, those in a block following each other."""
    if len(X) <= ROWS:
        return np.arange(len(X), dtype=np.int32)
    low = np.floor(X.min(axis=0) / BLOCK)
    sides = np.floor(X.max(axis=0) / BLOCK) - low + 1
    if np.prod(sides, dtype=float) <= CELLS * len(X):  # counted, which takes a fraction of sorting
        return _counted_order(X, low, sides.astype(np.int64))
    return np.argsort(cell_numbers(np.floor(X / BLOCK) - low), kind="stable").astype(np.int32)


@compiled
def _counted_order(X: np.ndarray, low: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """The same, by counting the points (N, 3) of each of all blocks from low (3,) on, sides (3,) of them."""
    block, first = np.empty(len(X), np.int32), np.zeros(sides[0] * sides[1] * sides[2] + 1, np.int64)
    for i in range(len(X)):
        x, y, z = np.floor(X[i, 0] / BLOCK), np.floor(X[i, 1] / BLOCK), np.floor(X[i, 2] / BLOCK)
        block[i] = (np.int64(x - low[0]) * sides[1] + np.int64(y - low[1])) * sides[2] + np.int64(z - low[2])
        first[block[i] + 1] += 1
    for k in range(1, len(first)):
        first[k] += first[k - 1]
    order = np.empty(len(X), np.int32)
    for i in range(len(X)):
        order[first[block[i]]] = i
        first[block[i]] += 1
    return order


def _parts(order: np.ndarray) -> list[np.ndarray]:
    return [order[a : a + ROWS] for a in range(0, len(order), ROWS)]


def _compact_tiles(
    X: np.ndarray, rows: np.ndarray, hinges: HashedHinges
) -> tuple[np.ndarray, Tiles, np.ndarray]:
    """Some rows (n,) of points X (N, 3) in a compact order, their tiles, and each one's strongest feature."""
    points = np.take(X, rows, axis=0).astype(np.float64)
    compact = compact_order(points - points.mean(axis=0), LANES)
    tiles, strongest = _tiles(np.take(points, compact, axis=0), hinges)
    return rows[compact], tiles, strongest[: len(rows)]


def _joined(parts: Sequence[Tiles]) -> Tiles:
    """Tiles of several parts, one after the other."""
    lengths = np.concatenate([np.diff(part.starts) for part in parts])
    columns = np.concatenate([part.columns for part in parts])
    return Tiles(np.append(0, np.cumsum(lengths)), columns, np.concatenate([part.values for part in parts]))


class _Room(NamedTuple):
    """What a tile's search works in. metres: (3 8,) coordinates from its first place [m]; local: the same in
    spacings from `base` (3,); begin, end: (3,) the box of nodes in reach, from base; along: (3 sides 8,) the
    features along each axis; sides: room for so many nodes an axis; radius: reach, in spacings."""

    metres: np.ndarray
    local: np.ndarray
    base: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    along: np.ndarray
    sides: int
    radius: np.float32


@compiled
def _room(hinges: HashedHinges) -> _Room:
    radius = np.float32(np.sqrt(-np.log(hinges.cutoff) / hinges.width))
    sides = SPREAD * (int(2 * radius) + 1)
    whole, along = np.empty((3, 3), np.int64), np.empty(3 * sides * LANES, np.float32)
    places = np.empty((2, 3 * LANES), np.float32)
    return _Room(places[0], places[1], whole[0], whole[1], whole[2], along, sides, radius)


@compiled
def _tiles(X: np.ndarray, hinges: HashedHinges) -> tuple[Tiles, np.ndarray]:
    """Tiles of points (n, 3) in a compact order, and the largest feature (8 T,) of each."""
    count, room = (len(X) + LANES - 1) // LANES, _room(hinges)
    starts, strongest = np.zeros(count + 1, np.int64), np.zeros(count * LANES, np.float32)
    each = (room.sides // SPREAD) ** 3
    most = each * max(SPREAD, LANES) + 1
    columns = np.empty(96 * count + most, np.int32)
    values, found = np.empty(LANES * len(columns), np.float32), 0
    for p in range(count):
        last = min(LANES, len(X) - p * LANES)
        _from_first(X, p, 0, last, room)
        whole = True
        for t in range(len(hinges.spacings)):
            if found + most > len(columns):
                more = len(columns) + most
                columns = np.concatenate((columns, np.empty(more, np.int32)))
                values = np.concatenate((values, np.empty(LANES * more, np.float32)))
            if not whole:
                _from_first(X, p, 0, last, room)
                whole = True
            if _box(X[LANES * p], t, hinges, room) <= SPREAD * each:
                found = _add(p, 0, last, t, hinges, room, columns, values, found, strongest)
                continue
            for lane in range(last):
                _from_first(X, p, lane, lane + 1, room)
                _box(X[LANES * p + lane], t, hinges, room)
                found = _add(p, lane, lane + 1, t, hinges, room, columns, values, found, strongest)
            whole = False
        starts[p + 1] = found
    return Tiles(starts, columns[:found].copy(), values[: LANES * found].copy()), strongest


@compiled
def _from_first(X: np.ndarray, p: int, first: int, last: int, room: _Room) -> None:
    """Fill the room's metres with places first..last of tile p; other lanes as if they were the first one."""
    for axis in range(3):
        for lane in range(LANES):
            here = X[LANES * p + lane, axis] if first <= lane < last else X[LANES * p + first, axis]
            room.metres[LANES * axis + lane] = here - X[LANES * p + first, axis]


@compiled
def _box(place: np.ndarray, t: int, hinges: HashedHinges, room: _Room) -> float:
    """How many nodes of shape t the box around all in reach of the room's metres holds, whose first place is
    `place` (3,); infinite where it is too long. Fills the room."""
    nodes = 1.0
    for axis in range(3):
        spacing = hinges.spacings[t, axis]
        first = place[axis] / spacing
        base = np.rint(first)
        metres, rate = load(room.metres, LANES * axis), every(np.float32(1 / spacing))
        local = plus_product(every(np.float32(first - base)), metres, rate)
        store(room.local, LANES * axis, local)
        smallest, largest = -highest(minus(every(np.float32(0)), local)), highest(local)
        if not largest - smallest + 2 * room.radius <= room.sides - 2:
            return np.inf
        room.base[axis] = np.int64(base)
        room.begin[axis] = np.int64(np.ceil(smallest - room.radius))
        room.end[axis] = np.int64(np.floor(largest + room.radius)) + 1
        nodes *= room.end[axis] - room.begin[axis]
    return nodes


@compiled
def _add(
    p: int,
    first: int,
    last: int,
    t: int,
    hinges: HashedHinges,
    room: _Room,
    columns: np.ndarray,
    values: np.ndarray,
    found: int,
    strongest: np.ndarray,
) -> int:
    """Add the hinge points of shape t in the room's box that places first..last of tile p reach, behind the
    `found` columns there are: how many there are then."""
    along, sides, base = room.along, room.sides, room.base
    for axis in range(3):
        place = load(room.local, LANES * axis)
        for n in range(room.begin[axis], room.end[axis]):
            away = minus(place, every(np.float32(n)))
            feature = exponential(times(times(away, away), every(-hinges.width)))
            store(along, LANES * (axis * sides + n - room.begin[axis]), feature)
    if last - first < LANES:
        for n in range(room.end[0] - room.begin[0]):
            for lane in range(LANES):
                if lane < first or lane >= last:
                    along[LANES * n + lane] = 0
    x0, y0, z0 = base[0] + room.begin[0], base[1] + room.begin[1], base[2] + room.begin[2]
    x1, y1, z1 = base[0] + room.end[0], base[1] + room.end[1], base[2] + room.end[2]
    least, loud = every(hinges.cutoff), every(hinges.amplitude[t])
    largest = load(strongest, LANES * p)
    for x in range(x0 >> BITS, (x1 - 1 >> BITS) + 1):
        of_x = ALONG[0, max(x0 - (x << BITS), 0), min(x1 - (x << BITS), SIDE)]
        for y in range(y0 >> BITS, (y1 - 1 >> BITS) + 1):
            of_xy = of_x & ALONG[1, max(y0 - (y << BITS), 0), min(y1 - (y << BITS), SIDE)]
            for z in range(z0 >> BITS, (z1 - 1 >> BITS) + 1):
                cube = cube_at(x, y, z, t, hinges)
                if cube < 0:
                    continue
                # The bits of a cube's nodes that are hinge points and in the box.
                left = hinges.filled[cube] & of_xy
                left &= ALONG[2, max(z0 - (z << BITS), 0), min(z1 - (z << BITS), SIDE)]
                while left:
                    node = lowest_bit(left)
                    left &= left - 1
                    i, j, k = node >> 2 * BITS, (node >> BITS) & (SIDE - 1), node & (SIDE - 1)
                    along_x = load(along, LANES * ((x << BITS) + i - x0))
                    along_y = load(along, LANES * (sides + (y << BITS) + j - y0))
                    along_z = load(along, LANES * (2 * sides + (z << BITS) + k - z0))
                    feature = above(times(times(along_x, along_y), along_z), least)
                    largest = larger(largest, feature)
                    # Written in any case, and written over unless it counts: a branch costs more.
                    columns[found] = hinges.cubes[cube, node]
                    store(values, LANES * found, times(feature, loud))
                    found += any_above(feature, least)
    store(strongest, LANES * p, largest)
    return found
