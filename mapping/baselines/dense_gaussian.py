"""Dense products of Gaussian weight posteriors over kernel features, bound by BLAS alone.

Half of every product is saved where its result is symmetric or its factor triangular. Matrices are C-ordered
and only their lower triangles count.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from scipy.linalg import blas, cho_solve, lapack

from mapping.errors import DataError
from mapping.kernels import dense_features

ROWS = 4096
"""Rows of features held at a time; bounds the memory, not the result."""


def feature_rows(
    X: np.ndarray, hinges: np.ndarray, gamma: float, bias: bool = False
) -> Iterator[tuple[slice, np.ndarray]]:
    """(rows, features (n, H) float32) of points X (N, d), none dropped; with `bias` a last column of 1."""
    points, centres = torch.from_numpy(np.asarray(X, np.float32)), torch.from_numpy(hinges)
    widths = torch.full((len(hinges),), gamma)
    for start in range(0, len(points), ROWS):
        rows = slice(start, min(start + ROWS, len(points)))
        phi = dense_features(points[rows], centres, widths)
        yield rows, np.pad(phi.numpy(), ((0, 0), (0, 1)), constant_values=1) if bias else phi.numpy()


def add_gram(total: np.ndarray, phi: np.ndarray, weights: np.ndarray) -> None:
    """total (H, H) float64 += sum_n w_n phi_n phi_n^T for phi (n, H) and weights (n,) >= 0, both float32.

    The sum over one block of rows is float32: its rounding, some 1e-6, is far below priors of 1e-4.
    """
    # BLAS sees the transpose of C-ordered arrays: its upper triangle is their lower one.
    total += blas.ssyrk(1.0, (phi * np.sqrt(weights)[:, None]).T, lower=0).T


def posterior(precision: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (H,) float64 and the precision's lower Cholesky factor (H, H) float32, Fortran order.

    Raises DataError when the precision (H, H) float64 is not positive definite.
    """
    factor, failed = lapack.dpotrf(precision.T, lower=0, clean=1)
    if failed:
        raise DataError(f"the posterior precision of {len(precision)} weights is not positive definite")
    mean = cho_solve((factor, False), information)
    return mean, np.asarray(factor.T, np.float32, order="F")


def variances(factor: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """phi_n^T (L L^T)^-1 phi_n (n,) for the factor L (H, H) of `posterior` and phi (n, H) float32."""
    whitened = blas.strsm(1.0, factor, phi.T, lower=1)
    return np.einsum("hn,hn->n", whitened, whitened)
