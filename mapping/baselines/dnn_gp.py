"""DNN-GP: a residual network whose last layer is a Gaussian process with random features.

The layer's features are sqrt(2 / M) cos(W h + b); its weights have the Laplace covariance
(ridge I + Phi^T Phi)^-1, and the softmax is averaged over it by the mean-field rule
logits / sqrt(1 + lambda variance). Liu et al. 2020, section 3; settings of the SNGP tutorial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import nn
from typing_extensions import Self

from mapping.baselines.base import UncertaintyClassifier, check_labelled_points
from mapping.baselines.residual_network import (
    NetworkConfig,
    ResidualNetwork,
    as_tensor,
    seeded_torch,
    train,
)


@dataclass(frozen=True)
class GaussianLayerConfig:
    """Settings of the random-feature Gaussian process layer."""

    features: int = 1024
    """Random features M."""
    kernel_scale: float = 1.0
    """Length of the RBF kernel in the hidden space."""
    ridge: float = 1.0
    """Prior precision of the weights."""
    mean_field: float = float(np.pi / 8)
    """Factor lambda of the mean-field rule."""


class RandomFeatureLayer(nn.Module):
    """Linear logits on frozen random Fourier features of an RBF kernel."""

    def __init__(self, inputs: int, classes: int, config: GaussianLayerConfig) -> None:
        super().__init__()
        self.frequencies = nn.Parameter(
            torch.randn(inputs, config.features) / config.kernel_scale, requires_grad=False
        )
        self.phases = nn.Parameter(2.0 * torch.pi * torch.rand(config.features), requires_grad=False)
        self.output = nn.Linear(config.features, classes, bias=False)

    def features(self, h: torch.Tensor) -> torch.Tensor:
        """(N, M) random features of hidden activations h (N, inputs)."""
        return (2.0 / self.phases.numel()) ** 0.5 * torch.cos(h @ self.frequencies + self.phases)

    def forward(self, h: torch.Tensor) -> torch.Tensor:
        return self.output(self.features(h))


class DnnGp(UncertaintyClassifier):
    """Residual network with a random-feature Gaussian process on top."""

    def __init__(self, config: NetworkConfig | None = None, layer: GaussianLayerConfig | None = None) -> None:
        self.config, self.layer = config or NetworkConfig(), layer or GaussianLayerConfig()

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        X, y, classes = check_labelled_points(X, y)
        with seeded_torch(rng):
            self.head = RandomFeatureLayer(self.config.width, classes, self.layer)
            self.network = ResidualNetwork(X.shape[1], self.head, self.config)
            self._train(X, y)
        with torch.no_grad():
            features = self.head.features(self.network.hidden(as_tensor(X))).double()
        precision = self.layer.ridge * torch.eye(self.layer.features, dtype=torch.float64)
        self._factor = torch.linalg.cholesky(precision + features.T @ features)
        return self

    def _train(self, X: np.ndarray, y: np.ndarray) -> None:
        train(self.network, X, y, self.config)

    def logits(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Logits (N, C) and their variance (N,), the same for every class, at X (N, d)."""
        with torch.no_grad():
            features = self.head.features(self.network.hidden(as_tensor(X)))
            whitened = torch.linalg.solve_triangular(self._factor, features.T.double(), upper=False)
            return self.head.output(features).double().numpy(), whitened.square().sum(dim=0).numpy()

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        logits, variance = self.logits(X)
        averaged = logits / np.sqrt(1.0 + self.layer.mean_field * variance)[:, None]
        return torch.softmax(torch.as_tensor(averaged), dim=1).numpy()
