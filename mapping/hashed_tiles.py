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
from mapping.hashed_hinges import BITS, SIDE, HashedHinges, cube_at
from mapping.kernels import cell_numbers
from mapping.lanes import (
    LANES,
    above,
    any_above,
    every,
    exponential,
    larger,
    load,
    minus,
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
SPREAD = 12
"""Points of a tile look for hinge points alone where the box around all that may be in reach holds more than
so many times the nodes that one of them has in reach, or is so many times as long."""


def features_in_tiles(X: np.ndarray, hinges: HashedHinges) -> TiledFeatures:
    """Features of points (N, 3), times their shape's amplitude; `strongest` is without it."""
    parts = map_in_threads(lambda rows: _compact_tiles(X, rows, hinges), _parts(_order_of(X)))
    orders, tiles, strongest = zip(*parts)
    # As few shares as there are threads: each has a derivative of its own.
    shares = [_joined(tiles[some]) for some in Threads().split(len(tiles))]
    return TiledFeatures(np.concatenate(orders), np.concatenate(strongest), shares, int(hinges.first[-1]))


def logits_at(
    X: np.ndarray, hinges: HashedHinges, W: np.ndarray, offset: np.ndarray, shares: bool = False
) -> np.ndarray:
    """offset (C,) + features times amplitude times W (H, C), at points (N, 3): (N, C) float32; their softmax
    where shares are asked for."""
    out, weights = np.empty((len(X), len(offset)), np.float32), flat(W)

    def answer(rows: np.ndarray) -> None:
        order, tiles, _ = _compact_tiles(X, rows, hinges)
        answer_tiles(tiles, weights, offset, shares, order, out)

    map_in_threads(answer, _parts(_order_of(X)))
    return out


def _order_of(X: np.ndarray) -> np.ndarray:
    """Indices (N,) of points, those in a block following each other."""
    if len(X) <= ROWS:
        return np.arange(len(X))
    block = np.floor(X / BLOCK)
    return np.argsort(cell_numbers(block - block.min(0)), kind="stable")


def _parts(order: np.ndarray) -> list[np.ndarray]:
    return [order[a : a + ROWS] for a in range(0, len(order), ROWS)]


def _compact_tiles(
    X: np.ndarray, rows: np.ndarray, hinges: HashedHinges
) -> tuple[np.ndarray, Tiles, np.ndarray]:
    """Some rows (n,) of points X (N, 3) in a compact order, their tiles, and each one's strongest feature."""
    points = X[rows].astype(np.float64)
    compact = compact_order(points - points.mean(axis=0), LANES)
    tiles, strongest = _tiles(points[compact], hinges)
    return rows[compact], tiles, strongest[: len(rows)]


def _joined(parts: Sequence[Tiles]) -> Tiles:
    """Tiles of several parts, one after the other."""
    lengths = np.concatenate([np.diff(part.starts) for part in parts])
    columns = np.concatenate([part.columns for part in parts])
    return Tiles(np.append(0, np.cumsum(lengths)), columns, np.concatenate([part.values for part in parts]))


class _Room(NamedTuple):
    """What a tile's search works in. local: (3 8,) coordinates from `base` (3,), in spacings; begin, end:
    (3,) the box of nodes in reach, from base; along: (3 sides 8,) the features along each axis; sides: room
    for so many nodes an axis; radius: reach, in spacings."""

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
    return _Room(np.empty(3 * LANES, np.float32), whole[0], whole[1], whole[2], along, sides, radius)


@compiled
def _tiles(X: np.ndarray, hinges: HashedHinges) -> tuple[Tiles, np.ndarray]:
    """Tiles of points (n, 3) in a compact order, and the largest feature (8 T,) of each."""
    count, room = (len(X) + LANES - 1) // LANES, _room(hinges)
    starts, strongest = np.zeros(count + 1, np.int64), np.zeros(count * LANES, np.float32)
    each = (room.sides // SPREAD) ** 3
    most = each * max(SPREAD, LANES)
    columns = np.empty(96 * count + most, np.int32)
    values, found = np.empty(LANES * len(columns), np.float32), 0
    for p in range(count):
        last = min(LANES, len(X) - p * LANES)
        for t in range(len(hinges.spacings)):
            if found + most > len(columns):
                more = len(columns) + most
                columns = np.concatenate((columns, np.empty(more, np.int32)))
                values = np.concatenate((values, np.empty(LANES * more, np.float32)))
            if _box(X, p, 0, last, t, hinges, room) <= SPREAD * each:
                found = _add(p, 0, last, t, hinges, room, columns, values, found, strongest)
                continue
            for lane in range(last):
                _box(X, p, lane, lane + 1, t, hinges, room)
                found = _add(p, lane, lane + 1, t, hinges, room, columns, values, found, strongest)
        starts[p + 1] = found
    return Tiles(starts, columns[:found].copy(), values[: LANES * found].copy()), strongest


@compiled
def _box(X: np.ndarray, p: int, first: int, last: int, t: int, hinges: HashedHinges, room: _Room) -> float:
    """How many nodes of shape t the box around all in reach of places first..last of tile p holds; infinite
    where it is too long. Fills the room, lanes of other places as if they were the first one's."""
    nodes = 1.0
    for axis in range(3):
        spacing = hinges.spacings[t, axis]
        base = np.rint(X[LANES * p + first, axis] / spacing)
        smallest = largest = np.float32(X[LANES * p + first, axis] / spacing - base)
        for lane in range(LANES):
            room.local[LANES * axis + lane] = smallest
        for lane in range(first, last):
            place = np.float32(X[LANES * p + lane, axis] / spacing - base)
            room.local[LANES * axis + lane] = place
            smallest, largest = min(smallest, place), max(largest, place)
        if largest - smallest + 2 * room.radius > room.sides - 2:
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
    for n in range(room.end[0] - room.begin[0]):
        for lane in range(LANES):
            if lane < first or lane >= last:
                along[LANES * n + lane] = 0
    x0, y0, z0 = base[0] + room.begin[0], base[1] + room.begin[1], base[2] + room.begin[2]
    x1, y1, z1 = base[0] + room.end[0], base[1] + room.end[1], base[2] + room.end[2]
    least, loud = every(hinges.cutoff), every(hinges.amplitude[t])
    for x in range(x0 >> BITS, (x1 - 1 >> BITS) + 1):
        for y in range(y0 >> BITS, (y1 - 1 >> BITS) + 1):
            for z in range(z0 >> BITS, (z1 - 1 >> BITS) + 1):
                cube = cube_at(x, y, z, t, hinges)
                if cube < 0:
                    continue
                nearest, beyond = max(z << BITS, z0), min((z + 1) << BITS, z1)
                for i in range(max(x << BITS, x0), min((x + 1) << BITS, x1)):
                    along_x = load(along, LANES * (i - x0))
                    for j in range(max(y << BITS, y0), min((y + 1) << BITS, y1)):
                        along_xy = times(along_x, load(along, LANES * (sides + j - y0)))
                        if not any_above(along_xy, least):
                            continue
                        row = ((i & (SIDE - 1)) * SIDE + (j & (SIDE - 1))) * SIDE
                        for k in range(nearest, beyond):
                            hinge = hinges.cubes[cube, row + (k & (SIDE - 1))]
                            if hinge < 0:
                                continue
                            feature = times(along_xy, load(along, LANES * (2 * sides + k - z0)))
                            if any_above(feature, least):
                                feature = above(feature, least)
                                columns[found] = hinge
                                store(values, LANES * found, times(feature, loud))
                                store(
                                    strongest,
                                    LANES * p,
                                    larger(load(strongest, LANES * p), feature),
                                )
                                found += 1
    return found
