"""Samples as the fit of a map with kernels of several shapes sees them: features, weights, and their order.

Knows points, weights and hinge points; must not know what a class means.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.config import FitConfig
from mapping.hashed_hinges import HashedHinges
from mapping.hashed_tiles import features_in_tiles
from mapping.lattice_factor import LatticeFactor
from mapping.softmax import FitReport, fit_softmax
from mapping.tiled_features import TiledFeatures

REACHED = 0.05
"""A sample whose strongest feature is below this is out of the hinge points' reach."""


@dataclass(frozen=True)
class WeighedFeatures:
    """features: rows in their own order; weights: (N,) of the rows, 1 in sum; total: what that sum was;
    factor: of their columns."""

    features: TiledFeatures
    weights: torch.Tensor
    total: float
    factor: LatticeFactor

    @classmethod
    def of(
        cls, X: np.ndarray, weights: np.ndarray, noise: np.ndarray, hinges: HashedHinges
    ) -> WeighedFeatures:
        """Of data X (n, 3) with weights (n,), then noise (m, 3), each of weight 1."""
        found = features_in_tiles(np.concatenate([X, noise]), hinges)
        weight = np.append(weights, np.ones(len(noise)))[found.order]
        # Noise out of reach is "uncertain" in any case, and would drive the outermost weights up.
        weight[found.strongest <= REACHED] = 0
        total = float(weight.sum())
        share = torch.from_numpy((weight / total).astype(np.float32))
        return cls(found, share, total, LatticeFactor.of(hinges))

    @property
    def count(self) -> int:
        """Number of samples, noise included."""
        return len(self.weights)

    def fit(
        self,
        target: np.ndarray,
        offset: np.ndarray,
        l2: float,
        config: FitConfig,
        start: np.ndarray | None = None,
    ) -> tuple[np.ndarray, FitReport]:
        """Weights (H, C) that explain targets (N, C), shares of the classes, in the caller's order.

        l2: penalty beside the sum over the samples as they were weighed, so that parts and wholes agree;
        start: (H, C) where the fit begins, 0 by default.
        """
        W, report = fit_softmax(
            self.features,
            torch.from_numpy(target[self.features.order]),
            self.weights,
            torch.from_numpy(offset),
            self.factor.scaled,
            l2 / self.total,
            config,
            None if start is None else torch.from_numpy(start),
        )
        return W.numpy(), report
