"""The occupancy maps that are compared, behind one interface, and the settings they share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np

from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig, BayesianHilbertMap
from mapping.baselines.hilbert import HilbertMap
from mapping.config import MapConfig
from mapping.contramap import ContraMap
from perception.lidar import BeamConfig
from tools.occupancy.fit import (
    UNCERTAIN,
    OccupancyMapConfig,
    draw,
    fit_occupancy,
    merged,
    occupancy_of,
    standard_deviation,
)
from tools.reproduce.landscape import Landscape, Split

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
class OccupancyConfig(OccupancyMapConfig):
    """The map's settings, and those of its rivals and of the protocol."""

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
        return occupancy_of(self.model, X)

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return draw(self.model, axes)


class _BayesianOccupancy:
    def __init__(self, model: BayesianHilbertMap) -> None:
        self.model = model

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        return self.model.predict_proba(X)[:, 1]

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return self.model.predict_proba(lattice.reshape(-1, 2)).reshape(*lattice.shape[:2], 2)


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
    if method == "contramap":
        return _SoftmaxOccupancy(fit_occupancy(split.X, split.y, split.noise, hinges, gamma, config))
    merge_data = 0.0 if method == "bayesian_hilbert" else config.merge_data
    X, y, weights = merged(split.X, split.y, 1.0, merge_data * standard_deviation(gamma))
    if method == "hilbert":
        model = HilbertMap(MapConfig(gamma=gamma, l2=config.l2, fit=config.fit))
        return _SoftmaxOccupancy(model.fit(X, y, hinges=hinges, weights=weights))
    bayesian = BayesianHilbertConfig(
        gamma=gamma, prior_precision=config.prior_precision, iterations=config.bayesian_iterations
    )
    return _BayesianOccupancy(BayesianHilbertMap(bayesian).fit(X, y, hinges, rng, progress, weights))


def with_noise(split: Split, noise_weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Training points and noise (N + M, 2), their classes and their weights."""
    y = np.concatenate([split.y, np.full(len(split.noise), UNCERTAIN)])
    weights = np.where(y == UNCERTAIN, noise_weight, 1.0)
    return np.concatenate([split.X, split.noise]), y, weights
