"""V-PRISM (Wright et al. 2024): a Gaussian posterior over the weights of every class of a kernel softmax.

Bouchard's bound on log-sum-exp, sigmoid by sigmoid, keeps the posterior Gaussian. With lambda(xi) =
(sigmoid(xi) - 1/2) / (2 xi) and a variational alpha_n, xi_nk for every sample, each iteration does

    Sigma_k^-1 = Sigma_0k^-1 + 2 sum_n lambda(xi_nk) phi_n phi_n^T
    mu_k       = Sigma_k (Sigma_0k^-1 mu_0k + sum_n (y_nk - 1/2 + 2 alpha_n lambda(xi_nk)) phi_n)
    alpha_n    = (1/2 (K/2 - 1) + sum_k lambda_nk mu_k.phi_n) / sum_k lambda_nk
    xi_nk^2    = phi_n^T Sigma_k phi_n + (mu_k.phi_n - alpha_n)^2

and the posterior of a batch is the prior of the next. This module knows points and classes.

Where its speed comes from: kernels reach 13 cm, so a compact group of points sees some hundred hinge points
and both the Gram sums and the variances are small matrix products within it; features below 1e-7 are
dropped, less than float32 rounding. One Cholesky factor a class serves mean and covariance. The precision
is kept in float64: its smallest eigenvalue, 1e-4, drowns in float32's rounding of its largest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from scipy.special import expit

from mapping.baselines.kernel_map import GaussianKernelMap
from mapping.errors import ConfigError
from mapping.kernels import dense_features, reach


@dataclass(frozen=True)
class VPrismConfig:
    """Settings of V-PRISM; the defaults are the published ones."""

    gamma: float = 1000.0
    """Kernel width: phi = exp(-gamma d^2), in 1/m^2."""
    prior_variance: float = 1e4
    """Variance of every weight's prior."""
    iterations: int = 3
    """Rounds of posterior and variational parameters a batch; xi starts at 1, alpha at 0."""
    batch: int = 20_000
    """Points a sequential update, at most."""
    alpha: Literal["published", "bound"] = "published"
    """Update of alpha: as the published code computes it (a product), or as the bound asks (a sum)."""
    bias: bool = True
    """Adds a feature that is 1 everywhere."""
    cutoff: float = 1e-7
    """Features below this are dropped; 0 keeps all of them (faster so: `DenseVPrism`)."""
    cell: float = 0.12
    """Side of the groups of points [m] that share hinge points."""


@dataclass(frozen=True)
class _Group:
    """Points that see the same features. rows: (n,); columns: (h,); phi: (n, h) float32."""

    rows: torch.Tensor
    columns: torch.Tensor
    phi: torch.Tensor


class VPrism(GaussianKernelMap):
    """K Gaussians over H weights; class probabilities by averaging the softmax over them."""

    def __init__(self, config: VPrismConfig | None = None) -> None:
        self.config = config or VPrismConfig()
        if self.config.alpha not in ("published", "bound"):
            raise ConfigError(f"alpha must be published or bound, got {self.config.alpha!r}")
        self.hinges = np.empty((0, 3), np.float32)

    @property
    def settings(self) -> VPrismConfig:
        return self.config

    @property
    def class_count(self) -> int:
        """K."""
        return len(self._information)

    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (N, K) of w_k . phi at points X (N, d)."""
        return self._batch_moments(self._groups(np.asarray(X, np.float32)), (len(X), self.class_count))

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, K) at X (N, d): the softmax averaged over the posterior.

        The average is an approximation, so rows sum to nearly 1.
        """
        return expected_softmax(*self.latent(X))

    def entropy(self, X: np.ndarray) -> np.ndarray:
        """V-PRISM's uncertainty: entropy (N,) of the probabilities over its largest value, in [0, 1]."""
        return normalised_entropy(self.predict_proba(X))

    def _start(self, classes: int) -> None:
        features = len(self.hinges) + self.config.bias
        self.precision = torch.eye(features, dtype=torch.float64).repeat(classes, 1, 1)
        self.precision /= self.config.prior_variance
        self._information = torch.zeros(classes, features, dtype=torch.float64)

    def _mean_weights(self) -> tuple[torch.Tensor, torch.Tensor]:
        weights = self.mu.T.float()
        bias = weights[-1] if self.config.bias else torch.zeros(self.class_count)
        return weights[: len(self.hinges)], bias

    def _update(self, X: np.ndarray, y: np.ndarray) -> None:
        X = X.astype(np.float32)
        groups = list(self._groups(X))
        prior, prior_information = self.precision, self._information
        one_hot = np.eye(self.class_count, dtype=np.float32)[y]
        xi, alpha = np.ones_like(one_hot), np.zeros(len(X), np.float32)
        for iteration in range(self.config.iterations):
            if iteration:
                alpha, xi = self._next(*self._batch_moments(groups, xi.shape), xi)
            slope = sigmoid_slope(xi)
            target = torch.from_numpy(one_hot - 0.5 + 2 * alpha[:, None] * slope)
            weights = torch.from_numpy(2 * slope)
            precision, information = prior.clone(), prior_information.clone()
            for group in groups:
                # In float64: the prior's 1e-4 must survive next to sums of some hundred.
                phi = group.phi.double()
                weighted = phi.T * weights[group.rows].T[:, None, :]  # (K, h, n)
                gram = (weighted @ phi).flatten(1)
                precision.view(len(precision), -1).index_add_(1, self._pairs(group.columns), gram)
                information[:, group.columns] += target[group.rows].T.double() @ phi
            factor = torch.linalg.cholesky(precision)
            self.mu = torch.cholesky_solve(information[..., None], factor)[..., 0]
            self.covariance = torch.cholesky_inverse(factor).contiguous()
            self.precision, self._information = precision, information

    def _batch_moments(
        self, groups: Iterable[_Group], shape: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of `shape` (N, K) at all points of the groups."""
        mean, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        for group in groups:
            m, v = self._moments(group)
            mean[group.rows.numpy()], variance[group.rows.numpy()] = m.numpy(), v.numpy()
        return mean, variance

    def _next(self, mean: np.ndarray, variance: np.ndarray, xi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The next alpha (N,) and xi (N, K) from the posterior's moments (N, K) and the current xi."""
        slope = sigmoid_slope(xi)
        total, constant = slope.sum(1), 0.5 * (self.class_count / 2 - 1)
        if self.config.alpha == "published":
            alpha = constant * (slope * mean).sum(1) / total
        else:
            alpha = (constant + (slope * mean).sum(1)) / total
        return alpha, np.sqrt(variance + (mean - alpha[:, None]) ** 2)

    def _moments(self, group: _Group) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and variance (n, K) float32 of a group's points."""
        columns = group.columns
        mean = group.phi.double() @ self.mu[:, columns].T
        # phi^T Sigma phi cancels in float32, where Sigma reaches 1e4; the squares of L^T phi do not.
        part = self.covariance.view(self.class_count, -1).index_select(1, self._pairs(columns))
        root = torch.linalg.cholesky(part.view(-1, len(columns), len(columns))).float()  # (K, h, h)
        variance = (group.phi @ root).square_().sum(2).T
        return mean.float(), variance

    def _pairs(self, columns: torch.Tensor) -> torch.Tensor:
        """Positions (h * h,) of all pairs of columns in a flattened (H, H) matrix."""
        return (columns[:, None] * self._information.shape[1] + columns).flatten()

    def _groups(self, X: np.ndarray) -> Iterator[_Group]:
        """Points in cells of `cell` and the features they see, the bias last."""
        hinges, gamma = self.hinges, self.config.gamma
        cutoff = self.config.cutoff
        radius = reach(gamma, cutoff) if cutoff > 0 else np.inf
        for rows in _cells(X, self.config.cell):
            points = X[rows]
            low, high = points.min(0), points.max(0)
            gap = np.maximum(np.maximum(low - hinges, hinges - high), 0)
            columns = np.flatnonzero((gap**2).sum(1) < radius**2)
            phi = dense_features(
                torch.from_numpy(points),
                torch.from_numpy(hinges[columns]),
                torch.full((len(columns),), gamma),
            )
            if self.config.bias:
                phi = torch.cat([phi, torch.ones(len(phi), 1)], 1)
                columns = np.append(columns, len(hinges))
            yield _Group(torch.from_numpy(rows), torch.from_numpy(columns), phi)


def expected_softmax(mean: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """E[softmax] (N, K) under independent Gaussians of the logits: mean, variance (N, K) (Daunizeau 2017)."""
    classes = mean.shape[1]
    # The sum over j of 1 / s_kj includes j = k, where s = 1/2: it takes 2 off again.
    total = np.full(mean.shape, -float(classes), np.float64)
    for j in range(classes):
        scale = np.sqrt(1 + np.pi / 8 * (variance + variance[:, j, None]))
        margin = (mean - mean[:, j, None]) / scale
        total += 1 + np.exp(np.clip(-margin, -60, 60))
    return (1 / total).astype(np.float32)


def normalised_entropy(probability: np.ndarray) -> np.ndarray:
    """Entropy (N,) of probabilities (N, K), which need not sum to 1, over log K."""
    p = probability / probability.sum(1, keepdims=True)
    return -(p * np.log(np.maximum(p, 1e-12))).sum(1) / np.log(p.shape[1])


def sigmoid_slope(xi: np.ndarray) -> np.ndarray:
    """lambda(xi) = (sigmoid(xi) - 1/2) / (2 xi), 1/8 at 0."""
    xi = np.maximum(xi, 1e-3)
    return ((expit(xi) - 0.5) / (2 * xi)).astype(np.float32)


def _cells(X: np.ndarray, side: float) -> list[np.ndarray]:
    """Row indices of the points in each occupied cell of `side`."""
    if not len(X):
        return []
    cell = np.floor((X - X.min(0)) / side).astype(np.int64)
    key = np.ravel_multi_index(tuple(cell.T), tuple(cell.max(0) + 1))
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    return np.split(order, starts[1:])
