"""Free, occupied and noise samples in the plane to a fitted map: what `occupancy` and its reproduction share.

Knows samples, hinge points and kernels; must not know logs, rectangles or files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mapping.config import FitConfig, MapConfig
from mapping.contramap import ContraMap
from mapping.samples import merge_in_cells

FREE, OCCUPIED, UNCERTAIN = 0, 1, 2
"""Classes, and columns of the maps' probabilities."""


@dataclass(frozen=True)
class OccupancyMapConfig:
    """Settings of an occupancy map; those of the paper's table."""

    kernel_width: float = 6.71 * 0.5**2
    """gamma times the area of a hinge point's cell; gamma is 6.71 1/m^2 on Intel's 0.5 m grid."""
    l2: float = 1e-7
    """Weight of the squared norm of W beside the mean cross-entropy (Hilbert map and ContraMap)."""
    noise_weight: float = 0.1
    """Weight of a noise sample; 1 lets noise outvote the data where they are sparse."""
    merge_data: float = 0.35
    """Data of one class in a cell of this many kernel standard deviations become one weighted sample, for all
    methods but the Bayesian Hilbert map as published; 0 keeps every sample."""
    merge_noise: float = 1.0
    """The same for noise. Its cells may be wider, since noise is even."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the Hilbert map's and ContraMap's loss is minimised."""


def fit_occupancy(
    X: np.ndarray,
    y: np.ndarray,
    noise: np.ndarray,
    hinges: np.ndarray,
    gamma: float,
    config: OccupancyMapConfig,
) -> ContraMap:
    """A ContraMap of points X (N, 2) [m], labels y (N,) FREE or OCCUPIED, and noise (M, 2) [m].

    hinges: (H, 2) [m]; gamma: kernel width [1/m^2].
    """
    width = standard_deviation(gamma)
    data = merged(X, y, 1.0, config.merge_data * width)
    uncertain = np.full(len(noise), UNCERTAIN)
    far = merged(noise, uncertain, config.noise_weight, config.merge_noise * width)
    X, y, weights = (np.concatenate(pair) for pair in zip(data, far))
    model = ContraMap(MapConfig(gamma=gamma, l2=config.l2, fit=config.fit))
    return model.fit(X, y, hinges=hinges, weights=weights, classes=UNCERTAIN + 1)


def merged(
    X: np.ndarray, y: np.ndarray, weight: float, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (M, 2), classes and weights (M,) that stand for X (N, 2) with `weight` each; size: of cells."""
    weights = np.full(len(X), weight)
    return merge_in_cells(X, y, weights, size) if size else (X, y, weights)


def standard_deviation(gamma: float) -> float:
    """The kernel's standard deviation [m]."""
    return float(1.0 / np.sqrt(2.0 * gamma))


def share_occupied(probabilities: np.ndarray) -> np.ndarray:
    """p_occupied / (p_occupied + p_free) of probabilities (..., 2 or 3)."""
    free, occupied = probabilities[..., 0].astype(np.float64), probabilities[..., 1].astype(np.float64)
    return occupied / np.maximum(free + occupied, 1e-30)


def occupancy_of(model: ContraMap, X: np.ndarray) -> np.ndarray:
    """(N,) p_occupied / (p_occupied + p_free) at points X (N, 2)."""
    return share_occupied(model.predict_proba(X))


def draw(model: ContraMap, axes: Sequence[np.ndarray]) -> np.ndarray:
    """(A, B, C) class probabilities on the lattice that x and y coordinates span."""
    return model.predict_lattice(tuple(axes))
