"""The occupancy maps that are compared, behind one interface, and the settings they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig, BayesianHilbertMap
from mapping.baselines.hilbert import HilbertMap
from mapping.config import FitConfig, MapConfig
from mapping.contramap import ContraMap
from mapping.samples import merge_in_cells
from perception.lidar import BeamConfig
from tools.reproduce.landscape import UNCERTAIN, Landscape, Split

TITLES = {
    "hilbert": "Hilbert map",
    "bayesian_hilbert": "Bayesian Hilbert map",
    "contramap": "ContraMap",
    "bayesian_hilbert_merged": "Bayesian Hilbert map, merged data",
}

METHODS = tuple(TITLES)
"""Methods in the order in which they run and are listed: the paper's three, then the Bayesian Hilbert map on
the merged samples that the Hilbert map and ContraMap learn from."""


@dataclass(frozen=True)
class OccupancyConfig:
    """Settings that every method shares, and those of the maps."""

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
    beams: BeamConfig = field(default_factory=BeamConfig)
    """How beams become labelled points."""
    held_out_run: int = 1
    """Consecutive scans held out together; 1 splits at random, 40 is the Hilbert maps reference."""
    query_per_hinge: int = 5
    """Map query points per hinge point along each axis; 5 is 0.1 m on Intel."""
    prior_precision: float = 1e-4
    """Prior precision of the Bayesian Hilbert map."""
    bayesian_iterations: int = 2
    """Rounds of posterior and xi a batch of the Bayesian Hilbert map."""

    def settings_of(self, method: str) -> dict[str, Any]:
        """The settings that the named method's result depends on."""
        unused = {
            "bayesian_hilbert": ("l2", "noise_weight", "merge_data", "merge_noise", "fit"),
            "bayesian_hilbert_merged": ("l2", "noise_weight", "merge_noise", "fit"),
        }.get(method, ("prior_precision", "bayesian_iterations"))
        return {key: value for key, value in asdict(self).items() if key not in unused}


class OccupancyMap(Protocol):
    """A fitted map, whatever its method."""

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        """(N,) p_occupied / (p_occupied + p_free) at points X (N, 2)."""

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """(A, B, C) class probabilities on the map's lattice."""


class _SoftmaxOccupancy:
    def __init__(self, model: ContraMap) -> None:
        self.model = model

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        return share_occupied(self.model.predict_proba(X))

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return self.model.predict_lattice(axes)


class _BayesianOccupancy:
    def __init__(self, model: BayesianHilbertMap) -> None:
        self.model = model

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        return self.model.predict_proba(X)[:, 1]

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return self.model.predict_proba(lattice.reshape(-1, 2)).reshape(*lattice.shape[:2], 2)


def share_occupied(probabilities: np.ndarray) -> np.ndarray:
    """p_occupied / (p_occupied + p_free) of probabilities (..., 2 or 3)."""
    free, occupied = probabilities[..., 0].astype(np.float64), probabilities[..., 1].astype(np.float64)
    return occupied / np.maximum(free + occupied, 1e-30)


def fit_method(
    method: str,
    split: Split,
    landscape: Landscape,
    config: OccupancyConfig,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> OccupancyMap:
    """Fit the named method to the split's training points."""
    gamma, hinges = landscape.gamma(config.kernel_width), landscape.hinges
    width = 1.0 / np.sqrt(2.0 * gamma)  # the kernel's standard deviation [m]
    merge_data = 0.0 if method == "bayesian_hilbert" else config.merge_data
    X, y, weights = _merged(split.X, split.y, 1.0, merge_data * width)
    if method.startswith("bayesian_hilbert"):
        bayesian = BayesianHilbertConfig(
            gamma=gamma, prior_precision=config.prior_precision, iterations=config.bayesian_iterations
        )
        model = BayesianHilbertMap(bayesian).fit(X, y, hinges, rng, progress, weights)
        return _BayesianOccupancy(model)
    map_config = MapConfig(gamma=gamma, l2=config.l2, fit=config.fit)
    if method == "hilbert":
        return _SoftmaxOccupancy(HilbertMap(map_config).fit(X, y, hinges=hinges, weights=weights))
    uncertain = np.full(len(split.noise), UNCERTAIN)
    noise = _merged(split.noise, uncertain, config.noise_weight, config.merge_noise * width)
    X, y, weights = (np.concatenate(pair) for pair in zip((X, y, weights), noise))
    return _SoftmaxOccupancy(ContraMap(map_config).fit(X, y, hinges=hinges, weights=weights))


def _merged(
    X: np.ndarray, y: np.ndarray, weight: float, size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples (M, 2), classes and weights (M,) that stand for X (N, 2) with `weight` each."""
    weights = np.full(len(X), weight)
    return merge_in_cells(X, y, weights, size) if size else (X, y, weights)


def with_noise(split: Split, noise_weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Training points and noise (N + M, 2), their classes and their weights."""
    y = np.concatenate([split.y, np.full(len(split.noise), UNCERTAIN)])
    weights = np.where(y == UNCERTAIN, noise_weight, 1.0)
    return np.concatenate([split.X, split.noise]), y, weights
