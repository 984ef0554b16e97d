"""Base of the baselines that keep a Gaussian over the weights of kernels, updated batch after batch.

Knows points, classes and batches; knows nothing of the bound that keeps the posterior Gaussian.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
import torch
from typing_extensions import Self

from mapping.baselines.base import check_labelled_points
from mapping.baselines.unfitted import SaysUnfitted
from mapping.errors import DataError
from mapping.lattice import LatticeEvaluator


class BatchSettings(Protocol):
    """What the base reads of a baseline's settings: kernel width, and points a sequential update."""

    @property
    def gamma(self) -> float: ...

    @property
    def batch(self) -> int: ...


class GaussianKernelMap(SaysUnfitted, ABC):
    """K classes whose weights w_k have Gaussian posteriors; w_k . phi(x) has a mean and a variance.

    hinges: (H, d) float32.
    """

    hinges: np.ndarray

    @property
    @abstractmethod
    def settings(self) -> BatchSettings:
        """Kernel width and batch size."""

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        hinges: np.ndarray,
        rng: np.random.Generator,
        classes: int | None = None,
    ) -> Self:
        """Update the prior with points X (N, d) and labels y (N,) in 0..K-1, in random order.

        hinges: (H, d); classes: K when y may lack the last ones. Raises DataError for arrays that do not fit.
        """
        X, y, found = check_labelled_points(X, y)
        classes = found if classes is None else classes
        if classes < found:
            raise DataError(f"y holds {found} classes, more than the {classes} announced")
        self.hinges = np.ascontiguousarray(hinges, np.float32)
        self._start(classes)
        for batch in np.array_split(rng.permutation(len(X)), -(-len(X) // self.settings.batch)):
            self._update(X[batch], y[batch])
        return self

    @abstractmethod
    def latent(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance (N, K) of w_k . phi at points X (N, d)."""

    def mean_lattice(self) -> LatticeEvaluator:
        """The means of w_k . phi on any lattice: cheap there, where variances are not."""
        weights, offset = self._mean_weights()
        gamma = np.full(len(self.hinges), self.settings.gamma, np.float32)
        return LatticeEvaluator(self.hinges, gamma, weights, offset)

    @abstractmethod
    def _start(self, classes: int) -> None:
        """Set the prior of K classes."""

    @abstractmethod
    def _update(self, X: np.ndarray, y: np.ndarray) -> None:
        """Make the posterior of a batch, points (N, d) and labels (N,), the prior of the next."""

    @abstractmethod
    def _mean_weights(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Posterior mean of the weights (H, K) float32 and of the constant terms (K,)."""
