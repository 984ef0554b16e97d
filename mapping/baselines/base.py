"""What every baseline classifier with an uncertainty offers."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from typing_extensions import Self

from mapping.baselines.unfitted import SaysUnfitted
from mapping.errors import DataError


class UncertaintyClassifier(SaysUnfitted, ABC):
    """Points of R^d to probabilities of C classes, and one number that says how unsure the answer is.

    Subclasses give `fit` and `predict_proba`; those with an uncertainty of their own override `uncertainty`.
    """

    @abstractmethod
    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        """Learn from points X (N, d) with labels y (N,) in 0..C-1."""

    @abstractmethod
    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, C) at points X (N, d); rows sum to 1."""

    def uncertainty(self, X: np.ndarray) -> np.ndarray:
        """(N,) in [0, 1]: sum_c p_c (1 - p_c) over its largest value, 1 where all classes are alike."""
        return gini(self.predict_proba(X))


def gini(probabilities: np.ndarray) -> np.ndarray:
    """(N,) sum_c p_c (1 - p_c) over its largest value; for two classes this is 4 p (1 - p)."""
    classes = probabilities.shape[1]
    spread = 1.0 - (probabilities**2).sum(axis=1)
    return np.maximum(spread, 0.0) * (classes / (classes - 1))  # rounding may leave -1e-7


def check_labelled_points(X: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """X as float64 (N, d), y as int64 (N,), and the class count C; raises DataError when they do not fit."""
    X, y = np.asarray(X, np.float64), np.asarray(y)
    if X.ndim != 2 or y.shape != X.shape[:1] or not len(X):
        raise DataError(f"wanted points X (N, d) and labels y (N,) with N > 0, got {X.shape} and {y.shape}")
    if not np.isfinite(X).all():
        raise DataError("X holds NaN or infinite values")
    if not np.issubdtype(y.dtype, np.integer) or y.min() < 0:
        raise DataError(f"labels must be integers from 0, got {y.dtype} from {y.min()}")
    classes = int(y.max()) + 1
    if classes < 2:
        raise DataError("labels must hold at least two classes")
    return X, y.astype(np.int64), classes
