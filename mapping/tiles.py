"""Sparse rows in tiles of eight that share their columns, and the cross-entropy of a softmax of them.

Knows rows, columns, targets and weights; must not know points, kernels, or what a class means.

Rows that follow each other and lie near each other reach nearly the same hinge points: three of five entries
of such tiles are not 0, and a whole column of a tile is one vector of the processor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.lanes import (
    LANES,
    every,
    every_of,
    exponential,
    larger,
    load,
    logarithm,
    minus,
    over,
    plus,
    plus_product,
    store,
    times,
)

HALF = LANES // 2
"""So many classes, or fewer, are worked out at once where no more are left."""


class Tiles(NamedTuple):
    """Rows of a sparse matrix, eight a tile; the last tile may have fewer, the rest of it being 0.

    starts: (T + 1,) int64 where each tile's columns begin; columns: (n,) int32; values: (8 n,) float32, of
    each column its eight rows.
    """

    starts: np.ndarray
    columns: np.ndarray
    values: np.ndarray

    def part(self, tiles: slice) -> Tiles:
        """Some tiles that follow each other."""
        return Tiles(self.starts[tiles.start : tiles.stop + 1], self.columns, self.values)


@compiled
def tiles_of(ends: np.ndarray, columns: np.ndarray, values: np.ndarray, width: int) -> Tiles:
    """Tiles of rows: row i has columns[ends[i] : ends[i + 1]] and their values; `width` columns in all."""
    count = len(ends) - 1
    starts = np.zeros((count + LANES - 1) // LANES + 1, np.int64)
    of_tile = np.full(width, -1, np.int32)  # the last tile that has a column
    for t in range(len(starts) - 1):
        found = 0
        for k in range(ends[LANES * t], ends[min(LANES * (t + 1), count)]):
            found += of_tile[columns[k]] != t
            of_tile[columns[k]] = t
        starts[t + 1] = starts[t] + found
    shared = np.empty(starts[-1], np.int32)
    entries = np.zeros(LANES * len(shared), np.float32)
    place = np.full(width, -1, np.int64)  # of a column among all tiles'
    for t in range(len(starts) - 1):
        found = starts[t]
        for i in range(LANES * t, min(LANES * (t + 1), count)):
            for k in range(ends[i], ends[i + 1]):
                column = columns[k]
                if place[column] < starts[t]:
                    place[column], shared[found] = found, column
                    found += 1
                entries[LANES * place[column] + i - LANES * t] = values[k]
    return Tiles(starts, shared, entries)


@compiled
def tiled(rows: np.ndarray) -> np.ndarray:
    """Rows (N, C) float32 as tiles (T, C, 8), the last one filled with 0."""
    out = np.zeros(((len(rows) + LANES - 1) // LANES, rows.shape[1], LANES), np.float32)
    for i in range(len(rows)):
        for c in range(rows.shape[1]):
            out[i // LANES, c, i % LANES] = rows[i, c]
    return out


def flat(W: np.ndarray) -> np.ndarray:
    """Weights (H, C) as `cross_entropy` and `answer_tiles` read them: row by row, and eight numbers more."""
    return np.append(np.asarray(W, np.float32).reshape(-1), np.zeros(LANES, np.float32))


@compiled
def squares_of_columns(tiles: Tiles, weights: np.ndarray, width: int) -> np.ndarray:
    """Of every column (width,) the sum of its squared entries, each times its row's weight, of (T, 8)."""
    sums = np.zeros(width, np.float32)
    for t in range(len(tiles.starts) - 1):
        for k in range(tiles.starts[t], tiles.starts[t + 1]):
            for lane in range(LANES):
                value = tiles.values[LANES * k + lane]
                sums[tiles.columns[k]] += weights[t, lane] * value * value
    return sums


@compiled
def cross_entropy(
    tiles: Tiles, targets: np.ndarray, weights: np.ndarray, offset: np.ndarray, W: np.ndarray
) -> tuple[float, np.ndarray]:
    """sum_i w_i CE(softmax(W^T phi_i + offset), t_i), and its derivative by W.

    targets: (T, C, 8) float32, each row times its weight; weights: (T, 8) float32; offset: (C,) float32; W:
    (H C + 8,) float32, row by row, whose last eight numbers are read but do not count. Returns the derivative
    in the same form.
    """
    classes = targets.shape[1]
    padded = -(-classes // LANES) * LANES
    slopes = np.zeros(len(W), np.float32)
    logits = np.empty(padded * LANES, np.float32)
    residual = np.zeros(LANES * padded, np.float32)  # row by row
    lanes, target = np.empty(2 * LANES, np.float32), targets.reshape(-1)
    weight = weights.reshape(-1)
    loss = 0.0
    for t in range(len(tiles.starts) - 1):
        own = slice(tiles.starts[t], tiles.starts[t + 1])
        fill_logits(tiles, own.start, own.stop, W, offset, logits)
        highest = load(logits, 0)
        for c in range(1, classes):
            highest = larger(highest, load(logits, c * LANES))
        total, agreed = every(np.float32(0)), every(np.float32(0))
        for c in range(classes):
            logit = minus(load(logits, c * LANES), highest)
            agreed = plus_product(agreed, load(target, (t * classes + c) * LANES), logit)
            power = exponential(logit)
            store(logits, c * LANES, power)
            total = plus(total, power)
        store(lanes, 0, total)
        store(lanes, LANES, agreed)
        for lane in range(LANES):
            loss += weights[t, lane] * np.log(lanes[lane]) - lanes[LANES + lane]
        scale = over(load(weight, t * LANES), total)
        for c in range(classes):
            share = plus_product(
                minus(every(np.float32(0)), load(target, (t * classes + c) * LANES)),
                load(logits, c * LANES),
                scale,
            )
            store(lanes, 0, share)
            for lane in range(LANES):
                residual[lane * padded + c] = lanes[lane]
        add_slopes(tiles, own.start, own.stop, residual, padded, classes, slopes)
    return loss, slopes


@compiled
def curvatures(tiles: Tiles, weights: np.ndarray, offset: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Second derivatives by each weight, sum_i w_i p_ic (1 - p_ic) phi_ih^2; arguments and form: as in
    `cross_entropy`."""
    classes, weight = len(offset), weights.reshape(-1)
    padded = -(-classes // LANES) * LANES
    sums, logits = np.zeros(len(W), np.float32), np.empty(padded * LANES, np.float32)
    spread = np.zeros(LANES * padded, np.float32)  # row by row
    squares, lanes = np.empty(0, np.float32), np.empty(LANES, np.float32)
    for t in range(len(tiles.starts) - 1):
        own = slice(tiles.starts[t], tiles.starts[t + 1])
        fill_logits(tiles, own.start, own.stop, W, offset, logits)
        total = powers(classes, logits)
        for c in range(classes):
            share = over(load(logits, c * LANES), total)
            share = times(times(share, minus(every(np.float32(1)), share)), load(weight, t * LANES))
            store(lanes, 0, share)
            for lane in range(LANES):
                spread[lane * padded + c] = lanes[lane]
        if LANES * (own.stop - own.start) > len(squares):
            squares = np.empty(2 * LANES * (own.stop - own.start), np.float32)
        for k in range(own.stop - own.start):
            value = load(tiles.values, LANES * (own.start + k))
            store(squares, LANES * k, times(value, value))
        squared = Tiles(tiles.starts, tiles.columns[own], squares)
        add_slopes(squared, 0, own.stop - own.start, spread, padded, classes, sums)
    return sums


@compiled
def answer_tiles(
    tiles: Tiles,
    W: np.ndarray,
    offset: np.ndarray,
    order: np.ndarray,
    columns: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write the softmax of rows' logits to out: class c of row i goes to out[order[i], columns[c]]. W and
    offset: as in `cross_entropy`."""
    classes = len(offset)
    logits = np.empty(-(-classes // LANES) * LANES * LANES, np.float32)
    for t in range(len(tiles.starts) - 1):
        fill_logits(tiles, tiles.starts[t], tiles.starts[t + 1], W, offset, logits)
        total = powers(classes, logits)
        for c in range(classes):
            store(logits, c * LANES, over(load(logits, c * LANES), total))
        for lane in range(min(LANES, len(order) - LANES * t)):
            row = order[LANES * t + lane]
            for c in range(classes):
                out[row, columns[c]] = logits[c * LANES + lane]


@compiled
def log_sums(tiles: Tiles, W: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(8 T,) log-sum-exp of each row's logits. W and offset: as in `cross_entropy`."""
    classes, count = len(offset), len(tiles.starts) - 1
    logits = np.empty(-(-classes // LANES) * LANES * LANES, np.float32)
    out = np.empty(count * LANES, np.float32)
    for t in range(count):
        fill_logits(tiles, tiles.starts[t], tiles.starts[t + 1], W, offset, logits)
        highest = load(logits, 0)
        for c in range(1, classes):
            highest = larger(highest, load(logits, c * LANES))
        store(out, t * LANES, plus(highest, logarithm(powers(classes, logits))))
    return out


@compiled
def powers(classes: int, logits: np.ndarray) -> Any:
    """exp of a tile's logits (C, 8), less each row's largest, in their place; the vector of rows' sums."""
    highest = load(logits, 0)
    for c in range(1, classes):
        highest = larger(highest, load(logits, c * LANES))
    total = every(np.float32(0))
    for c in range(classes):
        power = exponential(minus(load(logits, c * LANES), highest))
        store(logits, c * LANES, power)
        total = plus(total, power)
    return total


@compiled
def fill_logits(
    tiles: Tiles, first: int, last: int, W: np.ndarray, offset: np.ndarray, logits: np.ndarray
) -> None:
    """Fill logits (C rounded up, 8) of the tile whose columns are first..last."""
    columns, values, classes = tiles.columns, tiles.values, len(offset)
    c = 0
    while c < classes:
        # More than its classes are worked out, from the next row's weights, where they do not fill a vector.
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = every(np.float32(0))
        if classes - c > HALF:
            for k in range(first, last):
                value, w = load(values, LANES * k), columns[k] * classes + c
                a0 = plus_product(a0, value, every_of(W, w))
                a1 = plus_product(a1, value, every_of(W, w + 1))
                a2 = plus_product(a2, value, every_of(W, w + 2))
                a3 = plus_product(a3, value, every_of(W, w + 3))
                a4 = plus_product(a4, value, every_of(W, w + 4))
                a5 = plus_product(a5, value, every_of(W, w + 5))
                a6 = plus_product(a6, value, every_of(W, w + 6))
                a7 = plus_product(a7, value, every_of(W, w + 7))
        else:
            for k in range(first, last):
                value, w = load(values, LANES * k), columns[k] * classes + c
                a0 = plus_product(a0, value, every_of(W, w))
                a1 = plus_product(a1, value, every_of(W, w + 1))
                a2 = plus_product(a2, value, every_of(W, w + 2))
                a3 = plus_product(a3, value, every_of(W, w + 3))
        store(logits, c * LANES, a0)
        store(logits, (c + 1) * LANES, a1)
        store(logits, (c + 2) * LANES, a2)
        store(logits, (c + 3) * LANES, a3)
        store(logits, (c + 4) * LANES, a4)
        store(logits, (c + 5) * LANES, a5)
        store(logits, (c + 6) * LANES, a6)
        store(logits, (c + 7) * LANES, a7)
        c += LANES
    for c in range(classes):
        store(logits, c * LANES, plus(load(logits, c * LANES), every(offset[c])))


@compiled
def add_slopes(
    tiles: Tiles, first: int, last: int, residual: np.ndarray, padded: int, classes: int, slopes: np.ndarray
) -> None:
    """Add a tile's share, residual (8, padded), to the derivative by its columns' weights, first..last."""
    columns, values = tiles.columns, tiles.values
    for c in range(0, classes, LANES):
        r0, r1 = load(residual, c), load(residual, padded + c)
        r2, r3 = load(residual, 2 * padded + c), load(residual, 3 * padded + c)
        r4, r5 = load(residual, 4 * padded + c), load(residual, 5 * padded + c)
        r6, r7 = load(residual, 6 * padded + c), load(residual, 7 * padded + c)
        for k in range(first, last):
            w, v = columns[k] * classes + c, LANES * k
            # Two sums, so that one product need not wait for another. Past the classes 0 is added.
            even = plus_product(load(slopes, w), r0, every_of(values, v))
            odd = plus_product(every(np.float32(0)), r1, every_of(values, v + 1))
            even = plus_product(even, r2, every_of(values, v + 2))
            odd = plus_product(odd, r3, every_of(values, v + 3))
            even = plus_product(even, r4, every_of(values, v + 4))
            odd = plus_product(odd, r5, every_of(values, v + 5))
            even = plus_product(even, r6, every_of(values, v + 6))
            odd = plus_product(odd, r7, every_of(values, v + 7))
            store(slopes, w, plus(even, odd))
