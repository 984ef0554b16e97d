"""The methods of the toy study by name, and its settings. Knows how each is made; judges none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from typing_extensions import Self

from mapping.baselines.base import UncertaintyClassifier
from mapping.baselines.deep_ensemble import DeepEnsemble
from mapping.baselines.dnn_gp import DnnGp, GaussianLayerConfig
from mapping.baselines.gaussian_process import GaussianProcess, GaussianProcessConfig
from mapping.baselines.mc_dropout import McDropout
from mapping.baselines.residual_network import NetworkConfig
from mapping.baselines.sngp import Sngp
from mapping.config import MapConfig
from mapping.contramap import ContraMap
from sim_scenes.toy2d import ToyConfig, ToySet

TITLES = {
    "gp": "Gaussian process",
    "mc_dropout": "MC dropout",
    "deep_ensemble": "Deep ensemble",
    "dnn_gp": "DNN-GP",
    "sngp": "SNGP",
    "contramap": "ContraMap",
}
METHODS = tuple(TITLES)
"""Methods in the paper's order; the Gaussian process is the reference and always runs."""


@dataclass(frozen=True)
class ToyStudyConfig:
    """Settings of the toy study; one set of settings for all three sets."""

    data: ToyConfig = field(default_factory=ToyConfig)
    """Sizes of the sets."""
    grid: int = 100
    """Query points along each axis of the mapped square."""
    map: MapConfig = field(default_factory=lambda: MapConfig(gamma=0.5, hinge_spacing=0.5, l2=1e-2))
    """ContraMap; gamma 0.5 is an RBF kernel of length 1, as in the Gaussian layers."""
    network: NetworkConfig = field(default_factory=NetworkConfig)
    """Network of the four neural methods."""
    layer: GaussianLayerConfig = field(default_factory=GaussianLayerConfig)
    """Gaussian process layer of DNN-GP and SNGP."""
    gaussian_process: GaussianProcessConfig = field(default_factory=GaussianProcessConfig)
    """The reference."""
    passes: int = 10
    """Passes of MC dropout."""
    members: int = 10
    """Members of the ensemble."""
    norm_bound: float = 0.9
    """SNGP's bound on the spectral norms."""

    def settings_of(self, method: str) -> dict[str, Any]:
        """The settings that the named method's result depends on."""
        used = {
            "gp": ("gaussian_process",),
            "mc_dropout": ("network", "passes"),
            "deep_ensemble": ("network", "members"),
            "dnn_gp": ("network", "layer"),
            "sngp": ("network", "layer", "norm_bound"),
            "contramap": ("map",),
        }[method]
        return {key: value for key, value in asdict(self).items() if key in ("data", "grid", *used)}


class ContraMapClassifier(UncertaintyClassifier):
    """ContraMap with as many uniform noise points in the box as data; its uncertainty is p(uncertain)."""

    def __init__(self, low: np.ndarray, high: np.ndarray, config: MapConfig) -> None:
        self.low, self.high, self.config = low, high, config

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        noise = rng.uniform(self.low, self.high, size=X.shape)
        labels = np.concatenate([y, np.full(len(noise), y.max() + 1)])
        self.model = ContraMap(self.config).fit(np.concatenate([X, noise]), labels)
        return self

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        structure = self.model.predict_proba(X)[:, :-1].astype(np.float64)
        return structure / structure.sum(axis=1, keepdims=True)

    def uncertainty(self, X: np.ndarray) -> np.ndarray:
        return self.model.predict_proba(X)[:, -1].astype(np.float64)


def make_method(name: str, toy: ToySet, config: ToyStudyConfig) -> UncertaintyClassifier:
    """The named method, not yet fitted."""
    makers: dict[str, Callable[[], UncertaintyClassifier]] = {
        "gp": lambda: GaussianProcess(config.gaussian_process),
        "mc_dropout": lambda: McDropout(config.network, config.passes),
        "deep_ensemble": lambda: DeepEnsemble(config.network, config.members),
        "dnn_gp": lambda: DnnGp(config.network, config.layer),
        "sngp": lambda: Sngp(config.network, config.layer, config.norm_bound),
        "contramap": lambda: ContraMapClassifier(toy.low, toy.high, config.map),
    }
    return makers[name]()
