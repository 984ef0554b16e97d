"""Exact binary Gaussian process classification: the gold standard of the toy experiments.

RBF kernel s^2 exp(-|x - x'|^2 / (2 l^2)) and logistic likelihood; the posterior is Laplace's approximation around
its mode (Rasmussen and Williams 2006, algorithms 3.1 and 3.2), with one N x N Cholesky factor and no inducing
points. l and s maximise the approximate marginal likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize
from scipy.special import expit
from typing_extensions import Self

from mapping.baselines.base import UncertaintyClassifier, check_labelled_points
from mapping.errors import DataError


@dataclass(frozen=True)
class GaussianProcessConfig:
    """Settings of the Gaussian process."""

    length_scale: float | None = None
    """Kernel length l in the unit of X; found by marginal likelihood when left out."""
    signal: float | None = None
    """Standard deviation s of the latent function; found by marginal likelihood when left out."""
    length_bounds: tuple[float, float] = (0.05, 10.0)
    """Search range of l."""
    signal_bounds: tuple[float, float] = (0.3, 30.0)
    """Search range of s; separable classes push it to the upper end."""
    search_points: int = 400
    """Points, at most, on which l and s are searched; the posterior uses all points."""
    newton_steps: int = 50
    """Newton steps, at most, to the mode."""
    tolerance: float = 1e-8
    """Stop when the log posterior changes by less than this."""


class GaussianProcess(UncertaintyClassifier):
    """Binary Gaussian process classifier; its uncertainty is the latent posterior variance over s^2."""

    def __init__(self, config: GaussianProcessConfig = GaussianProcessConfig()) -> None:
        self.config = config

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        X, y, classes = check_labelled_points(X, y)
        if classes != 2:
            raise DataError(f"the Gaussian process is binary, got {classes} classes")
        config = self.config
        self.length_scale, self.signal = config.length_scale or 1.0, config.signal or 1.0
        if config.length_scale is None or config.signal is None:
            chosen = rng.permutation(len(X))[: config.search_points]
            self._search(X[chosen], y[chosen])
        self.X = X
        self._mode = _laplace_mode(self._kernel(X, X), y, config)
        return self

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean (N,) and variance (N,) of the latent function at X (N, d)."""
        cross = self._kernel(self.X, np.asarray(X, np.float64))  # (n, N)
        mode = self._mode
        whitened = solve_triangular(mode.factor, mode.root_w[:, None] * cross, lower=True)
        return mode.gradient @ cross, np.maximum(self.signal**2 - (whitened**2).sum(axis=0), 0.0)

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        mean, variance = self.latent(X)
        p = expit(mean / np.sqrt(1.0 + np.pi / 8.0 * variance))
        return np.stack([1.0 - p, p], axis=1)

    def uncertainty(self, X: np.ndarray) -> np.ndarray:
        """(N,) latent posterior variance over the prior's: 0 on dense data, 1 far from any."""
        return self.latent(X)[1] / self.signal**2

    def _kernel(self, A: np.ndarray, B: np.ndarray) -> np.ndarray:
        squared = (A**2).sum(axis=1)[:, None] + (B**2).sum(axis=1) - 2.0 * A @ B.T
        return self.signal**2 * np.exp(-np.maximum(squared, 0.0) / (2.0 * self.length_scale**2))

    def _search(self, X: np.ndarray, y: np.ndarray) -> None:
        config = self.config

        def negative_evidence(log_parameters: np.ndarray) -> float:
            self.length_scale, self.signal = np.exp(log_parameters)
            return -_laplace_mode(self._kernel(X, X), y, config).log_evidence

        bounds = [
            config.length_bounds if config.length_scale is None else (config.length_scale,) * 2,
            config.signal_bounds if config.signal is None else (config.signal,) * 2,
        ]
        found = minimize(
            negative_evidence,
            x0=np.log([np.clip(1.0, *bounds[0]), np.clip(3.0, *bounds[1])]),
            method="Powell",
            bounds=np.log(bounds),
            options={"xtol": 0.05, "ftol": 1e-4},
        )
        self.length_scale, self.signal = (float(value) for value in np.exp(found.x))


@dataclass(frozen=True)
class _Mode:
    gradient: np.ndarray
    """(n,) gradient of the log likelihood at the mode; the posterior mean is K(X*, X) gradient."""
    root_w: np.ndarray
    """(n,) square root of the likelihood's negative curvature."""
    factor: np.ndarray
    """(n, n) lower Cholesky factor of I + W^1/2 K W^1/2."""
    log_evidence: float


def _laplace_mode(K: np.ndarray, y: np.ndarray, config: GaussianProcessConfig) -> _Mode:
    """Newton's method to the posterior mode, in the form that never inverts K."""
    f, a, objective = np.zeros(len(y)), np.zeros(len(y)), -np.inf
    sign = 2.0 * y - 1.0
    for _ in range(config.newton_steps):
        p = expit(f)
        root_w = np.sqrt(p * (1.0 - p))
        factor = cholesky(np.eye(len(y)) + root_w[:, None] * K * root_w, lower=True)
        b = root_w**2 * f + (y - p)
        step = b - root_w * cho_solve((factor, True), root_w * (K @ b)) - a
        previous, rate = objective, 1.0
        while True:  # halve the step until the log posterior rises
            trial = a + rate * step
            f = K @ trial
            objective = -0.5 * trial @ f - np.logaddexp(0.0, -sign * f).sum()
            if objective > previous - config.tolerance or rate < 1e-3:
                break
            rate *= 0.5
        a = trial
        if objective - previous < config.tolerance:
            break
    p = expit(f)
    root_w = np.sqrt(p * (1.0 - p))
    factor = cholesky(np.eye(len(y)) + root_w[:, None] * K * root_w, lower=True)
    return _Mode(y - p, root_w, factor, float(objective - np.log(np.diag(factor)).sum()))
