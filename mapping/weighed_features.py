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
from mapping.last_class import LastClass
from mapping.lattice_factor import LatticeFactor
from mapping.local_steps import fit_locally
from mapping.objectives import TiledObjective
from mapping.softmax import FitReport, fit_softmax, minimise
from mapping.threads import Threads
from mapping.tiled_features import TiledFeatures

REACHED = 0.05
"""A sample whose strongest feature is below this is out of the hinge points' reach."""


@dataclass(frozen=True)
class WeighedFeatures:
    """features: rows in their own order; weights: (N,) float64 of the rows."""

    features: TiledFeatures
    weights: np.ndarray

    @classmethod
    def of(cls, X: np.ndarray, weights: np.ndarray, hinges: HashedHinges) -> WeighedFeatures:
        """Of points X (N, 3) with weights (N,)."""
        found = features_in_tiles(X, hinges)
        weight = weights[found.order].astype(np.float64)
        # What is out of reach cannot be explained, and would drive the outermost weights up.
        weight[found.strongest <= REACHED] = 0
        return cls(found, weight)


def fit_classes(
    samples: WeighedFeatures,
    targets: np.ndarray,
    offset: np.ndarray,
    factor: LatticeFactor,
    l2: float,
    config: FitConfig,
    steps: int = 0,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, FitReport]:
    """Weights (H, C) that explain targets (N, C), shares of the classes, in the caller's order.

    l2: penalty beside the sum over the samples as they were weighed, so that parts and wholes agree; steps:
    so many local ones, or, where it is 0, quasi-Newton ones as config says; start: (H, C) where the fit
    begins, 0 by default.
    """
    total = float(samples.weights.sum())
    shares = torch.from_numpy((samples.weights / total).astype(np.float32))
    wanted, given = torch.from_numpy(targets[samples.features.order]), torch.from_numpy(offset)
    begin = None if start is None else torch.from_numpy(start)
    if steps:
        with Threads() as threads:
            weighed = wanted * shares[:, None]
            objective = TiledObjective(samples.features, weighed, shares, given, l2 / total, threads)
            W, report = fit_locally(objective, steps, begin)
    else:
        W, report = fit_softmax(
            samples.features, wanted, shares, given, factor.scaled, l2 / total, config, begin
        )
    return W.numpy(), report


def fit_last_class(
    samples: list[WeighedFeatures],
    targets: list[np.ndarray],
    W: np.ndarray,
    offset: np.ndarray,
    factor: LatticeFactor,
    l2: float,
    config: FitConfig,
    steps: int = 0,
) -> np.ndarray:
    """Weights (H, 1) of one more class, the others' W (H, C) staying as they are.

    targets: of each kind of samples, (N,) shares of that class; offset: (C + 1,); l2, steps: as in
    `fit_classes`.
    """
    total = float(sum(kind.weights.sum() for kind in samples))
    with Threads() as threads:
        objective = LastClass(
            [kind.features for kind in samples],
            [target[kind.features.order] for kind, target in zip(samples, targets)],
            [(kind.weights / total).astype(np.float32) for kind in samples],
            W,
            offset,
            l2 / total,
            threads,
        )
        if steps:
            found, _ = fit_locally(objective, steps, None)
        else:
            start = torch.zeros(objective.shape)
            whitened = factor.scaled(objective.curvature())
            found, _ = minimise(objective, whitened, factor.scaled, config, start)
    return found.numpy()
