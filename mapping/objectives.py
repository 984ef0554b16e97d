"""The penalised cross-entropy of a softmax and its derivative, as what a quasi-Newton fit asks for.

Knows features, targets and weights; knows nothing of points, kernels, what a class means, or how it is
minimised.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch

from mapping.bounds import class_bounds
from mapping.sparse_features import SparseFeatures
from mapping.threads import Threads
from mapping.tiled_features import TiledFeatures
from mapping.tiles import cross_entropy, curvatures, flat, squares_of_columns, tiled


class Objective(Protocol):
    """sum_i w_i CE(softmax(W^T phi_i + offset), t_i) + l2/2 ||W||^2 of weights W (H, C)."""

    shape: tuple[int, int]

    def curvature(self) -> torch.Tensor:
        """The diagonal (H,) of a bound on each class's Hessian: p (1 - p) is at most 1/4."""

    def curvature_at(self, W: torch.Tensor) -> torch.Tensor:
        """The diagonal (H, C) of the Hessian at W (H, C)."""

    def at(self, W: torch.Tensor) -> tuple[float, torch.Tensor]:
        """The objective at W (H, C) and its derivative (H, C)."""


class Bounded(Protocol):
    """An objective whose curvature is bounded weight by weight, from the samples that touch a weight."""

    shape: tuple[int, int]

    def bound_at(self, W: torch.Tensor) -> torch.Tensor:
        """The diagonal (H, C) of a matrix that is no less than the Hessian near W (H, C)."""

    def at(self, W: torch.Tensor) -> tuple[float, torch.Tensor]:
        """The objective at W (H, C) and its derivative (H, C)."""


def objective_of(
    features: TiledFeatures | SparseFeatures,
    targets: torch.Tensor,
    weights: torch.Tensor,
    offset: torch.Tensor,
    l2: float,
    threads: Threads,
) -> Objective:
    """The objective of samples whose features are given in tiles, on a processor, or sparse, on any device.

    targets: (N,) int64 classes or (N, C) float32 distributions; weights: (N,); offset: (C,).
    """
    if targets.ndim == 1:
        targets = torch.nn.functional.one_hot(targets, len(offset)).float()
    targets = targets * weights[:, None]
    if isinstance(features, TiledFeatures):
        return TiledObjective(features, targets, weights, offset, l2, threads)
    return _SparseObjective(features, targets, weights, offset, l2)


class TiledObjective:
    """Of targets (N, C) times their weights: in one pass over the tiles of each share, whose features stay in
    the processor's cache meanwhile."""

    def __init__(
        self,
        features: TiledFeatures,
        targets: torch.Tensor,
        weights: torch.Tensor,
        offset: torch.Tensor,
        l2: float,
        threads: Threads,
    ):
        self.shape = features.hinge_count, len(offset)
        self.l2, self.threads, self.offset = l2, threads, offset.numpy()
        ends = np.cumsum([len(share.starts) - 1 for share in features.shares])[:-1]
        of_tiles = (tiled(rows) for rows in (targets.numpy(), weights.numpy()[:, None]))
        targets_of, weights_of = (np.split(rows, ends) for rows in of_tiles)
        self.shares = [
            (tiles, own, np.ascontiguousarray(weight[:, 0]))
            for tiles, own, weight in zip(features.shares, targets_of, weights_of)
        ]

    def curvature(self) -> torch.Tensor:
        squares = self.threads.map(
            lambda share: squares_of_columns(share[0], share[2], self.shape[0]), self.shares
        )
        return torch.from_numpy(0.25 * np.sum(squares, 0) + np.float32(self.l2))

    def curvature_at(self, W: torch.Tensor) -> torch.Tensor:
        weights = flat(W.numpy())
        sums = self.threads.map(
            lambda share: curvatures(share[0], share[2], self.offset, weights), self.shares
        )
        return torch.from_numpy(np.sum(sums, 0)[: W.numel()].reshape(W.shape) + np.float32(self.l2))

    def bound_at(self, W: torch.Tensor) -> torch.Tensor:
        weights = flat(W.numpy())
        sums = self.threads.map(
            lambda share: class_bounds(share[0], share[2], self.offset, weights), self.shares
        )
        return torch.from_numpy(np.sum(sums, 0)[: W.numel()].reshape(W.shape) + np.float32(self.l2))

    def at(self, W: torch.Tensor) -> tuple[float, torch.Tensor]:
        weights = flat(W.numpy())
        losses, slopes = zip(
            *self.threads.map(
                lambda share: cross_entropy(share[0], share[1], share[2], self.offset, weights), self.shares
            )
        )
        total = slopes[0]
        for other in slopes[1:]:
            total += other
        gradient = torch.from_numpy(total[: W.numel()].reshape(W.shape)).add_(W, alpha=self.l2)
        return sum(losses) + 0.5 * self.l2 * _dot(W, W), gradient


class _SparseObjective:
    """By torch's sparse products."""

    def __init__(
        self,
        features: SparseFeatures,
        targets: torch.Tensor,
        weights: torch.Tensor,
        offset: torch.Tensor,
        l2: float,
    ):
        self.shape = features.hinge_count, len(offset)
        self.rows, self.columns = features.rows, features.rows.transposed(features.hinge_count)
        self.targets, self.weights, self.offset, self.l2 = targets, weights, offset, l2

    def curvature(self) -> torch.Tensor:
        return 0.25 * self.columns.squared().times(self.weights[:, None])[:, 0] + self.l2

    def curvature_at(self, W: torch.Tensor) -> torch.Tensor:
        p = torch.softmax(self.rows.times(W) + self.offset, 1)
        return self.columns.squared().times(p * (1 - p) * self.weights[:, None]) + self.l2

    def at(self, W: torch.Tensor) -> tuple[float, torch.Tensor]:
        log_p = torch.log_softmax(self.rows.times(W) + self.offset, 1)
        loss = -_dot(self.targets, log_p) + 0.5 * self.l2 * _dot(W, W)
        residual = log_p.exp_().mul_(self.weights[:, None]).sub_(self.targets)
        return loss, self.columns.times(residual).add_(W, alpha=self.l2)


def _dot(a: torch.Tensor, b: torch.Tensor) -> float:
    return float(torch.dot(a.reshape(-1), b.reshape(-1)))
