"""Exact Gaussian process classification by Dirichlet regression: the gold standard of the toy experiments.

A label is a Dirichlet observation with concentration 1 + a for its class and a for the others; its logarithm
is close to normal, with noise that depends on the class only (Milios et al. 2018). So each class is one
exact GP regression, with one N x N Cholesky factor and no inducing points, and the posterior variance depends
on where the data lie. A Laplace posterior would not do as a reference: its variance stays near the prior's on
confident data. RBF kernel s^2 exp(-|x - x'|^2 / (2 l^2)); l and s maximise the marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.special import softmax
from typing_extensions import Self

from mapping.baselines.base import UncertaintyClassifier, check_labelled_points

MEAN_FIELD = np.pi / 8
"""Factor of the variance in the mean-field softmax, logits / sqrt(1 + factor variance)."""


@dataclass(frozen=True)
class GaussianProcessConfig:
    """Settings of the Gaussian process."""

    length_scale: float | None = None
    """Kernel length l in the unit of X; found by marginal likelihood when left out."""
    signal: float | None = None
    """Standard deviation s of the latent functions; found by marginal likelihood when left out."""
    concentration: float = 0.01
    """Dirichlet concentration a of the classes that a label is not."""
    length_bounds: tuple[float, float] = (0.05, 10.0)
    """Search range of l."""
    signal_bounds: tuple[float, float] = (0.3, 30.0)
    """Search range of s."""
    search_points: int = 400
    """Points, at most, on which l and s are searched; the posterior uses all points."""


class GaussianProcess(UncertaintyClassifier):
    """One exact GP a class; the uncertainty is the mean over classes of posterior over prior variance."""

    def __init__(self, config: GaussianProcessConfig | None = None) -> None:
        self.config = config or GaussianProcessConfig()

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        X, y, classes = check_labelled_points(X, y)
        config = self.config
        self.length_scale, self.signal = config.length_scale or 1.0, config.signal or 1.0
        target, noise = self._observations(y, classes)
        if config.length_scale is None or config.signal is None:
            chosen = rng.permutation(len(X))[: config.search_points]
            self._search(X[chosen], target[chosen], noise[chosen])
        self.X = X
        self.factors = self._factors(X, noise)  # (C, N, N)
        self.alpha = np.stack([cho_solve((L, True), t) for L, t in zip(self.factors, target.T)])  # (C, N)
        return self

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior means (N, C) and variances (N, C) of the latent functions at X (N, d)."""
        cross = self._kernel(self.X, np.asarray(X, np.float64))  # (n, N)
        explained = [(solve_triangular(L, cross, lower=True) ** 2).sum(axis=0) for L in self.factors]
        return (self.alpha @ cross).T, np.maximum(self.signal**2 - np.stack(explained, axis=1), 0.0)

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        mean, variance = self.latent(X)
        return softmax(mean / np.sqrt(1.0 + MEAN_FIELD * variance), axis=1)

    def uncertainty(self, X: np.ndarray) -> np.ndarray:
        """(N,) posterior variance over the prior's: near 0 on dense data, 1 far from any."""
        return self.latent(X)[1].mean(axis=1) / self.signal**2

    def _observations(self, y: np.ndarray, classes: int) -> tuple[np.ndarray, np.ndarray]:
        """Log-normal match of the Dirichlet labels: centred targets (N, C) and noise variances (N, C)."""
        concentration = self.config.concentration + np.eye(classes)[y]
        noise = np.log1p(1.0 / concentration)
        target = np.log(concentration) - 0.5 * noise
        return target - target.mean(), noise  # one mean for all classes: far from data none is preferred

    def _kernel(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        squared = (A**2).sum(axis=1)[:, None] + (B**2).sum(axis=1) - 2.0 * A @ B.T
        return self.signal**2 * np.exp(-np.maximum(squared, 0.0) / (2.0 * self.length_scale**2))

    def _factors(self, X: np.ndarray, noise: np.ndarray) -> np.ndarray:
        K = self._kernel(X, X)
        return np.stack([cholesky(K + np.diag(variance), lower=True) for variance in noise.T])

    def _search(self, X: np.ndarray, target: np.ndarray, noise: np.ndarray) -> None:
        config = self.config

        def negative_evidence(log_parameters: np.ndarray) -> float:
            self.length_scale, self.signal = np.exp(log_parameters)
            try:
                factors = self._factors(X, noise)
            except LinAlgError:
                return np.inf
            return sum(
                0.5 * np.square(solve_triangular(L, t, lower=True)).sum() + np.log(np.diag(L)).sum()
                for L, t in zip(factors, target.T)
            )

        bounds = [
            config.length_bounds if config.length_scale is None else (config.length_scale,) * 2,
            config.signal_bounds if config.signal is None else (config.signal,) * 2,
        ]
        start = np.log([np.clip(1.0, *bounds[0]), np.clip(3.0, *bounds[1])])
        options = {"xatol": 0.01, "fatol": 0.01}
        found = minimize(
            negative_evidence, start, method="Nelder-Mead", bounds=np.log(bounds), options=options
        )
        self.length_scale, self.signal = (float(value) for value in np.exp(found.x))
