"""SNGP: DNN-GP whose residual layers have bounded spectral norms, so that distances survive."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from mapping.baselines.dnn_gp import DnnGp, GaussianLayerConfig
from mapping.baselines.residual_network import NetworkConfig, train


class SpectralBound:
    """Keeps the largest singular value of linear layers at or under a bound, by power iteration.

    Miyato et al. 2018: one or few iterations a step are enough because the weights move slowly; the singular
    vectors are kept from step to step.
    """

    def __init__(self, layers: list[nn.Linear], bound: float, iterations: int) -> None:
        self.layers, self.bound, self.iterations = layers, bound, iterations
        self._left = [nn.functional.normalize(torch.randn(layer.out_features), dim=0) for layer in layers]

    @torch.no_grad()
    def apply(self, iterations: int | None = None) -> None:
        """Scale every layer whose estimated norm exceeds the bound."""
        for index, layer in enumerate(self.layers):
            left = self._left[index]
            for _ in range(iterations or self.iterations):
                right = nn.functional.normalize(left @ layer.weight, dim=0)
                left = nn.functional.normalize(layer.weight @ right, dim=0)
            norm = torch.dot(left, layer.weight @ right)
            if norm > self.bound:
                layer.weight.mul_(self.bound / norm)
            self._left[index] = left


class Sngp(DnnGp):
    """Spectral-normalised neural Gaussian process (Liu et al. 2020)."""

    FINAL_ITERATIONS = 100
    """Power iterations of the last bound, so that the trained norms keep it closely."""

    def __init__(
        self,
        config: NetworkConfig | None = None,
        layer: GaussianLayerConfig | None = None,
        norm_bound: float = 0.9,
        power_iterations: int = 1,
    ) -> None:
        super().__init__(config, layer)
        self.norm_bound, self.power_iterations = norm_bound, power_iterations

    def _train(self, X: np.ndarray, y: np.ndarray) -> None:
        layers = [layer for layer in self.network.residual if isinstance(layer, nn.Linear)]
        bound = SpectralBound(layers, self.norm_bound, self.power_iterations)
        bound.apply(self.FINAL_ITERATIONS)
        train(self.network, X, y, self.config, after_step=bound.apply)
        bound.apply(self.FINAL_ITERATIONS)
