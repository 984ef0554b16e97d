"""Bounds on a softmax's curvature that hold weight by weight, from the samples that touch a weight alone.

Knows tiles of features, their weights and logits; must not know points, kernels or how a loss is minimised.

Of non-negative features phi and any weights a >= 0, sum_i a_i phi_i phi_i^T is at most the diagonal matrix of
sum_i a_i phi_ih sum_k phi_ik (Gershgorin). A logistic loss lies below a parabola of curvature
tanh(m / 2) / (2 m) that touches it at margin m (Jaakkola and Jordan 2000): 1/4 where two classes are level,
less the surer they are. Each class of a softmax against the rest has twice that (Gershgorin again).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mapping.compiled import compiled
from mapping.lanes import (
    LANES,
    every,
    larger,
    load,
    logarithm,
    minus,
    over,
    plus,
    store,
    sum_of,
    times,
)
from mapping.tiles import Tiles, add_slopes, fill_logits, powers

LEVEL = np.float32(1e-3)
"""Margins below this count as so much: the parabola's curvature is 1/4 there."""
SURE = np.float32(1e-7)
"""The least share that is left to the other classes."""


@compiled
def column_sums(tiles: Tiles, rows: np.ndarray, width: int) -> np.ndarray:
    """(width,) sum_i rows_i phi_ih sum_k phi_ik of every column h; rows: (8 T,)."""
    sums = np.zeros(width, np.float32)
    for t in range(len(tiles.starts) - 1):
        row = times(load(rows, LANES * t), _row_sums(tiles, t))
        for k in range(tiles.starts[t], tiles.starts[t + 1]):
            sums[tiles.columns[k]] += sum_of(times(load(tiles.values, LANES * k), row))
    return sums


@compiled
def class_bounds(tiles: Tiles, weights: np.ndarray, offset: np.ndarray, W: np.ndarray) -> np.ndarray:
    """The diagonal of a bound on the Hessian near W; arguments and form: as in `cross_entropy`."""
    classes, weight = len(offset), weights.reshape(-1)
    padded = -(-classes // LANES) * LANES
    sums, logits = np.zeros(len(W), np.float32), np.empty(padded * LANES, np.float32)
    bound, lanes = np.zeros(LANES * padded, np.float32), np.empty(LANES, np.float32)
    for t in range(len(tiles.starts) - 1):
        own = slice(tiles.starts[t], tiles.starts[t + 1])
        fill_logits(tiles, own.start, own.stop, W, offset, logits)
        total = powers(classes, logits)
        row = times(load(weight, t * LANES), _row_sums(tiles, t))
        for c in range(classes):
            power = load(logits, c * LANES)
            curvature = parabola(power, minus(total, power), total)
            store(lanes, 0, times(row, plus(curvature, curvature)))
            for lane in range(LANES):
                bound[lane * padded + c] = lanes[lane]
        add_slopes(tiles, own.start, own.stop, bound, padded, classes, sums)
    return sums


@compiled
def parabola(ours: Any, others: Any, total: Any) -> Any:
    """tanh(m / 2) / (2 m) where m = |ln(ours / others)|, of eight numbers each; total: ours + others."""
    none = every(np.float32(0))
    least = times(total, every(SURE))
    lead = minus(ours, others)
    lead = over(larger(lead, minus(none, lead)), total)  # tanh(m / 2)
    margin = minus(logarithm(larger(ours, least)), logarithm(larger(others, least)))
    margin = larger(margin, minus(none, margin))
    return over(larger(lead, every(LEVEL / 2)), times(larger(margin, every(LEVEL)), every(np.float32(2))))


@compiled
def _row_sums(tiles: Tiles, t: int) -> Any:
    """The sums of tile t's rows."""
    # Two sums, so that one need not wait for another.
    even, odd = every(np.float32(0)), every(np.float32(0))
    first, last = tiles.starts[t], tiles.starts[t + 1]
    for k in range(first, last - 1, 2):
        even = plus(even, load(tiles.values, LANES * k))
        odd = plus(odd, load(tiles.values, LANES * k + LANES))
    if (last - first) % 2:
        even = plus(even, load(tiles.values, LANES * (last - 1)))
    return plus(even, odd)
