"""Bayesian Hilbert map (Senanayake and Ramos 2017): binary, full covariance, Jaakkola-Jordan bound.

p(y = 1 | x) = sigmoid(w . phi(x)) with w ~ N(0, I / prior_precision). The bound replaces each sigmoid by a
Gaussian with a variational xi_n, so that every batch updates a Gaussian posterior in closed form:

    Lambda = Lambda_0 + 2 sum_n lambda(xi_n) phi_n phi_n^T,  lambda(xi) = (sigmoid(xi) - 1/2) / (2 xi),
    Lambda mu = Lambda_0 mu_0 + sum_n (y_n - 1/2) phi_n,     xi_n^2 = phi_n^T Lambda^-1 phi_n + (mu.phi_n)^2.

The posterior of a batch is the prior of the next. Features are not truncated, as published: the cost is
N H^2 for every update and Q H^2 for Q queries. The two products run in float32; the precision is summed and
factored in float64, and never inverted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, cho_solve, lapack
from scipy.special import expit
from typing_extensions import Self

from mapping.baselines.base import check_labelled_points
from mapping.baselines.unfitted import SaysUnfitted
from mapping.errors import DataError


@dataclass(frozen=True)
class BayesianHilbertConfig:
    """Settings of the Bayesian Hilbert map."""

    gamma: float = 6.71
    """Kernel width: phi = exp(-gamma d^2), in 1/m^2."""
    prior_precision: float = 1e-4
    """Precision of the weights' prior."""
    iterations: int = 2
    """Rounds of posterior and xi a batch; xi starts at 1."""
    batch: int = 20_000
    """Points a sequential update, at most."""
    rows: int = 4096
    """Rows of dense features held at a time; bounds the memory, not the result."""


class BayesianHilbertMap(SaysUnfitted):
    """Gaussian posterior over the weights of a binary kernel map, updated batch after batch."""

    def __init__(self, config: BayesianHilbertConfig | None = None) -> None:
        self.config = config or BayesianHilbertConfig()

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        hinges: np.ndarray,
        rng: np.random.Generator,
        progress: Callable[[int, int], None] = lambda done, total: None,
        weights: np.ndarray | None = None,
    ) -> Self:
        """Update the prior with points X (N, d) and labels y (N,), 0 free and 1 occupied, in random order.

        hinges: (H, d). progress is called with the batches done and their total. weights: (N,) > 0, how many
        observations a point stands for; 1 when left out.
        """
        X, y, classes = check_labelled_points(X, y)
        if classes != 2:
            raise DataError(f"the Bayesian Hilbert map is binary, got {classes} classes")
        weights = np.ones(len(X)) if weights is None else np.asarray(weights, np.float64)
        if weights.shape != y.shape or not (weights > 0).all():
            raise DataError(f"weights must be {len(X)} numbers > 0, got shape {weights.shape}")
        self.hinges = np.asarray(hinges, np.float32)
        self.precision = self.config.prior_precision * np.eye(len(hinges), order="F")
        self._information = np.zeros(len(hinges))
        batches = np.array_split(rng.permutation(len(X)), -(-len(X) // self.config.batch))
        for done, batch in enumerate(batches, start=1):
            self._update(X[batch], y[batch], weights[batch])
            progress(done, len(batches))
        return self

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean (N,) and variance (N,) of w . phi at X (N, d)."""
        mean, variance = np.empty(len(X)), np.empty(len(X))
        factor = self._factor.astype(np.float32, order="F")
        for rows, phi in self._features(X):
            mean[rows] = phi @ self.mu
            whitened = blas.strsm(1.0, factor, phi.T, lower=1, overwrite_b=1)
            variance[rows] = np.einsum("hn,hn->n", whitened, whitened)
        return mean, variance

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Free and occupied probability (N, 2): sigmoid(mean / sqrt(1 + pi variance / 8)) is occupied."""
        mean, variance = self.latent(X)
        p = expit(mean / np.sqrt(1.0 + np.pi / 8.0 * variance))
        return np.stack([1.0 - p, p], axis=1)

    def _update(self, X: np.ndarray, y: np.ndarray, weights: np.ndarray) -> None:
        prior, xi = self.precision, np.ones(len(X))
        for rows, phi in self._features(X):
            self._information += phi.T @ (weights[rows] * (y[rows] - 0.5))
        for iteration in range(self.config.iterations):
            if iteration:
                mean, variance = self.latent(X)
                xi = np.sqrt(variance + mean**2)
            curvature = weights * (expit(xi) - 0.5) / xi  # 2 lambda(xi), once for each observation
            scatter = np.zeros(prior.shape, np.float32, order="F")
            for rows, phi in self._features(X):
                phi *= np.sqrt(curvature[rows, None])
                scatter = blas.ssyrk(1.0, phi.T, beta=1.0, c=scatter, lower=1, overwrite_c=1)
            self.precision = prior + scatter
            self._factor, failed = lapack.dpotrf(self.precision, lower=1, clean=1)
            if failed:
                raise DataError(
                    f"the posterior precision is not positive definite ({len(self.hinges)} hinge points); "
                    "raise prior_precision or gamma"
                )
            self.mu = cho_solve((self._factor, True), self._information)

    def _features(self, X: np.ndarray) -> Iterator[tuple[slice, np.ndarray]]:
        """Dense float32 features (n, H) of X, a bounded number of rows at a time."""
        points = np.asarray(X, np.float32)
        for start in range(0, len(points), self.config.rows):
            rows = slice(start, min(start + self.config.rows, len(points)))
            squared = np.zeros((rows.stop - rows.start, len(self.hinges)), np.float32)
            for axis in range(points.shape[1]):
                squared += (points[rows, axis, None] - self.hinges[:, axis]) ** 2
            squared *= -self.config.gamma
            yield rows, np.exp(squared, out=squared)
