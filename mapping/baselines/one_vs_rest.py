"""Bayesian Hilbert maps of several classes, each against the rest, on the same points and hinge points.

The updates of `bayesian_hilbert.py`, class by class, with what the classes have in common done once: the
features, and the Gram sums of each batch's first round, where every xi is 1.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.special import expit

from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig
from mapping.baselines.dense_gaussian import add_gram, feature_rows, posterior, variances
from mapping.baselines.kernel_map import GaussianKernelMap


class OneVsRestHilbertMap(GaussianKernelMap):
    """K Gaussian posteriors over the weights of binary kernel maps: class k against all others."""

    def __init__(self, config: BayesianHilbertConfig | None = None) -> None:
        self.config = config or BayesianHilbertConfig()

    @property
    def settings(self) -> BayesianHilbertConfig:
        return self.config

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (N, K) float32 of w_k . phi at X (N, d)."""
        mean = np.empty((len(X), len(self.mu)), np.float32)
        variance = np.empty_like(mean)
        for rows, phi in feature_rows(X, self.hinges, self.config.gamma):
            mean[rows] = phi @ self.mu.T.astype(np.float32)
            for k, factor in enumerate(self._factors):
                variance[rows, k] = variances(factor, phi)
        return mean, variance

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Probability (N, K) of each class alone, against the rest; rows need not sum to 1."""
        mean, variance = self.latent(X)
        return expit(mean / np.sqrt(1.0 + np.pi / 8.0 * variance))

    def _start(self, classes: int) -> None:
        features = len(self.hinges)
        self.precision = np.tile(self.config.prior_precision * np.eye(features), (classes, 1, 1))
        self._information = np.zeros((classes, features))

    def _mean_weights(self) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.from_numpy(self.mu.T.astype(np.float32)), torch.zeros(len(self.mu))

    def _update(self, X: np.ndarray, y: np.ndarray) -> None:
        prior = self.precision
        target = np.eye(len(prior), dtype=np.float32)[y] - np.float32(0.5)
        common = np.zeros(prior.shape[1:])
        curvature = np.full(len(X), expit(1.0) - 0.5, np.float32)  # 2 lambda(xi) = (sigmoid(xi) - 1/2) / xi
        for rows, phi in feature_rows(X, self.hinges, self.config.gamma):
            self._information += target[rows].T.astype(np.float64) @ phi
            add_gram(common, phi, curvature[rows])
        self._solve(prior + common)
        for _ in range(1, self.config.iterations):
            mean, variance = self.latent(X)
            xi = np.sqrt(variance + mean**2)
            slopes = ((expit(xi) - 0.5) / xi).astype(np.float32)
            precision = prior.copy()
            for rows, phi in feature_rows(X, self.hinges, self.config.gamma):
                for k in range(len(precision)):
                    add_gram(precision[k], phi, slopes[rows, k])
            self._solve(precision)

    def _solve(self, precision: np.ndarray) -> None:
        """Means and factors of all classes from their precisions (K, H, H)."""
        found = [posterior(*pair) for pair in zip(precision, self._information)]
        self.mu = np.stack([mean for mean, _ in found])
        self._factors = [factor for _, factor in found]
        self.precision = precision
