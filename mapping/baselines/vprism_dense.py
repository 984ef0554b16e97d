"""V-PRISM as published: every feature is kept, whatever its size.

The mathematics and the answers of `vprism.py`, for measuring what its truncated features save. A batch costs
N H^2 for each class and round, a query H^2 for each class, in float32; one Cholesky factor a class, float64,
serves the mean and all variances.
"""

from __future__ import annotations

import numpy as np
import torch

from mapping.baselines.dense_gaussian import add_gram, feature_rows, posterior, variances
from mapping.baselines.vprism import VPrism, sigmoid_slope


class DenseVPrism(VPrism):
    """V-PRISM without truncated features."""

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (N, K) of w_k . phi at points X (N, d)."""
        mean = np.empty((len(X), self.class_count), np.float32)
        variance = np.empty_like(mean)
        weights = self.mu.numpy().T.astype(np.float32)
        for rows, phi in feature_rows(X, self.hinges, self.config.gamma, self.config.bias):
            mean[rows] = phi @ weights
            for k, factor in enumerate(self._factors):
                variance[rows, k] = variances(factor, phi)
        return mean, variance

    def _update(self, X: np.ndarray, y: np.ndarray) -> None:
        prior, prior_information = self.precision, self._information
        one_hot = np.eye(self.class_count, dtype=np.float32)[y]
        xi, alpha = np.ones_like(one_hot), np.zeros(len(X), np.float32)
        for iteration in range(self.config.iterations):
            if iteration:
                alpha, xi = self._next(*self.latent(X), xi)
            slope = sigmoid_slope(xi)
            target = one_hot - 0.5 + 2 * alpha[:, None] * slope
            self.precision, self._information = prior.clone(), prior_information.clone()
            for rows, phi in feature_rows(X, self.hinges, self.config.gamma, self.config.bias):
                self._information += torch.from_numpy(target[rows].T.astype(np.float64) @ phi)
                for k, precision in enumerate(self.precision.numpy()):
                    add_gram(precision, phi, 2 * slope[rows, k])
            found = [posterior(*pair) for pair in zip(self.precision.numpy(), self._information.numpy())]
            self.mu = torch.from_numpy(np.stack([mean for mean, _ in found]))
            self._factors = [factor for _, factor in found]
