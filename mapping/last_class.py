"""One more class beside given ones: a logistic regression against what the others' logits sum to.

Knows features, weights and the logits of the classes that are given; must not know points, kernels or what a
class means.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch

from mapping.bounds import column_sums, parabola
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
    sum_of,
    times,
)
from mapping.threads import Threads
from mapping.tiled_features import TiledFeatures
from mapping.tiles import Tiles, flat, log_sums, squares_of_columns, tiled


class _Share(NamedTuple):
    """Tiles; targets, weights and the others' log-sum-exp of their rows, (8 T,) float32 each."""

    tiles: Tiles
    targets: np.ndarray
    weights: np.ndarray
    others: np.ndarray


class LastClass:
    """sum_i w_i CE(sigmoid(u^T phi_i + offset - others_i), t_i) + l2/2 ||u||^2 of weights u (H, 1), an
    `Objective`: of a softmax whose other classes' weights W (H, C) stay as they are, what the last one's can
    change.

    features: samples of several kinds; targets, weights: of each kind, (N,) in the order of its rows; W,
    offset: of the classes that are given, and, last, the offset of this one.
    """

    def __init__(
        self,
        features: Sequence[TiledFeatures],
        targets: Sequence[np.ndarray],
        weights: Sequence[np.ndarray],
        W: np.ndarray,
        offset: np.ndarray,
        l2: float,
        threads: Threads,
    ):
        self.shape = features[0].hinge_count, 1
        self.l2, self.threads, self.offset = l2, threads, np.float32(offset[-1])
        given = flat(W)
        parts: list[tuple[Tiles, np.ndarray, np.ndarray]] = []
        for kind, target, weight in zip(features, targets, weights):
            ends = np.cumsum([len(share.starts) - 1 for share in kind.shares])[:-1]
            columns = [tiled(rows[:, None]).reshape(-1, LANES) for rows in (target * weight, weight)]
            parts += zip(kind.shares, *(np.split(rows, ends) for rows in columns))
        self.shares = threads.map(
            lambda part: _Share(
                part[0],
                np.ascontiguousarray(part[1]).reshape(-1),
                np.ascontiguousarray(part[2]).reshape(-1),
                log_sums(part[0], given, offset[:-1]),
            ),
            parts,
        )

    def curvature(self) -> torch.Tensor:
        squares = self.threads.map(
            lambda share: squares_of_columns(share.tiles, share.weights.reshape(-1, LANES), self.shape[0]),
            self.shares,
        )
        return torch.from_numpy(0.25 * np.sum(squares, 0) + np.float32(self.l2))

    def curvature_at(self, W: torch.Tensor) -> torch.Tensor:
        weights = W.numpy().reshape(-1)
        sums = self.threads.map(lambda share: _curvatures(share, self.offset, weights), self.shares)
        return torch.from_numpy(np.sum(sums, 0)[:, None] + np.float32(self.l2))

    def bound_at(self, W: torch.Tensor) -> torch.Tensor:
        weights = W.numpy().reshape(-1)

        def bound(share: _Share) -> np.ndarray:
            rows = _parabolas(share, self.offset, weights)
            return np.asarray(column_sums(share.tiles, rows, self.shape[0]))

        sums = self.threads.map(bound, self.shares)
        return torch.from_numpy(np.sum(sums, 0)[:, None] + np.float32(self.l2))

    def at(self, W: torch.Tensor) -> tuple[float, torch.Tensor]:
        weights = W.numpy().reshape(-1)
        losses, slopes = zip(
            *self.threads.map(lambda share: _logistic(share, self.offset, weights), self.shares)
        )
        gradient = torch.from_numpy(np.sum(slopes, 0)[:, None]).add_(W, alpha=self.l2)
        return sum(losses) + 0.5 * self.l2 * float(W.square().sum()), gradient


@compiled
def _logistic(share: _Share, offset: float, W: np.ndarray) -> tuple[float, np.ndarray]:
    """The loss of some tiles, without the penalty, and its derivative (H,) by W (H,)."""
    tiles, targets, weights, others = share
    slopes, loss, none = np.zeros(len(W), np.float32), 0.0, every(np.float32(0))
    for t in range(len(tiles.starts) - 1):
        logit, other = _logit(tiles, t, offset, W), load(others, LANES * t)
        weight, target = load(weights, LANES * t), load(targets, LANES * t)
        highest = larger(logit, other)
        logit, other = minus(logit, highest), minus(other, highest)
        power = exponential(logit)
        total = plus(power, exponential(other))
        ours = plus_product(plus_product(none, target, logit), minus(weight, target), other)
        loss += sum_of(minus(times(weight, logarithm(total)), ours))
        residual = minus(times(weight, over(power, total)), target)
        _add_to_columns(tiles, t, residual, False, slopes)
    return loss, slopes


@compiled
def _curvatures(share: _Share, offset: float, W: np.ndarray) -> np.ndarray:
    """Second derivatives (H,) of some tiles' loss."""
    tiles, _, weights, others = share
    sums, one = np.zeros(len(W), np.float32), every(np.float32(1))
    for t in range(len(tiles.starts) - 1):
        logit, other = _logit(tiles, t, offset, W), load(others, LANES * t)
        highest = larger(logit, other)
        power = exponential(minus(logit, highest))
        p = over(power, plus(power, exponential(minus(other, highest))))
        spread = times(times(p, minus(one, p)), load(weights, LANES * t))
        _add_to_columns(tiles, t, spread, True, sums)
    return sums


@compiled
def _parabolas(share: _Share, offset: float, W: np.ndarray) -> np.ndarray:
    """(8 T,) curvature of a parabola above each row's loss, times its weight."""
    tiles, _, weights, others = share
    out = np.empty(len(weights), np.float32)
    for t in range(len(tiles.starts) - 1):
        logit, other = _logit(tiles, t, offset, W), load(others, LANES * t)
        highest = larger(logit, other)
        power, rest = exponential(minus(logit, highest)), exponential(minus(other, highest))
        curvature = parabola(power, rest, plus(power, rest))
        store(out, LANES * t, times(curvature, load(weights, LANES * t)))
    return out


@compiled
def _logit(tiles: Tiles, t: int, offset: float, W: np.ndarray) -> Any:
    """The logits of tile t: offset plus its features times W (H,)."""
    # Two sums, so that one product need not wait for another.
    even, odd = every(np.float32(offset)), every(np.float32(0))
    first, last = tiles.starts[t], tiles.starts[t + 1]
    for k in range(first, last - 1, 2):
        even = plus_product(even, load(tiles.values, LANES * k), every_of(W, tiles.columns[k]))
        odd = plus_product(odd, load(tiles.values, LANES * k + LANES), every_of(W, tiles.columns[k + 1]))
    if (last - first) % 2:
        k = last - 1
        even = plus_product(even, load(tiles.values, LANES * k), every_of(W, tiles.columns[k]))
    return plus(even, odd)


@compiled
def _add_to_columns(tiles: Tiles, t: int, rows: Any, squared: bool, sums: np.ndarray) -> None:
    """Add to the sum (H,) of each column of tile t its values, or their squares, times those of its rows."""
    for k in range(tiles.starts[t], tiles.starts[t + 1]):
        value = load(tiles.values, LANES * k)
        product = times(value, rows)
        sums[tiles.columns[k]] += sum_of(times(value, product) if squared else product)
