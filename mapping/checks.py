"""What arrays given to a map must be, and the one line for each that is not.

Knows arrays of points, classes, weights and widths; knows nothing of fitting.
"""

from __future__ import annotations

import numpy as np

from mapping.errors import DataError

COARSEST = 0.02
"""Float32 must tell coordinates apart that are this share of the narrowest kernel's width from each other."""
LEAST_REACHED = 1e-3
"""Share of the samples in reach of hinge points below which units or frames must be wrong."""
LARGEST_GRID = 2_000_000
"""Hinge points of the largest default grid."""


def checked_points(X: np.ndarray, dimensions: int | None = None) -> np.ndarray:
    """Points (N, d) as float32. Raises DataError for other shapes, text, NaN and what float32 cannot hold."""
    try:
        with np.errstate(over="ignore"):
            X = np.ascontiguousarray(X, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise DataError(f"points must be an array of numbers ({error})") from error
    if X.ndim != 2 or (dimensions is not None and X.shape[1] != dimensions) or X.shape[1] == 0:
        wanted = f"(N, {dimensions})" if dimensions else "(N, d)"
        raise DataError(f"points must have shape {wanted}, got {X.shape}")
    if not np.isfinite(X).all():
        raise DataError("points hold NaN or infinite values, or some too large for float32")
    return X


def checked_classes(y: np.ndarray, count: int, classes: int | None) -> tuple[np.ndarray, int]:
    """y as an array (N,) of classes or (N, C+1) of distributions, and C + 1.

    Raises DataError when it does not fit `count` points, or holds anything but classes 0..C or shares.
    """
    y = np.asarray(y)
    if len(np.shape(y)) not in (1, 2) or len(y) != count:
        raise DataError(f"y must be (N,) classes or (N, C+1) distributions for {count} points, got {y.shape}")
    if count == 0:
        raise DataError("there are no points to fit")
    if y.dtype.kind not in "biuf":
        raise DataError(f"y must hold numbers, got {y.dtype}")
    if y.ndim == 2:
        if not (np.isfinite(y).all() and (y >= 0).all()):
            raise DataError("distributions in y must be finite and >= 0")
        return y, y.shape[1]
    if not np.isfinite(y).all() or (y != np.floor(y)).any():
        raise DataError("classes in y must be whole numbers")
    y = y.astype(np.int64)
    known = int(classes or y.max() + 1)
    if y.min() < 0 or y.max() >= known:
        raise DataError(f"y must lie in 0..{known - 1}, got {y.min()}..{y.max()}")
    return y, known


def checked_widths(gamma: np.ndarray | float, count: int, name: str = "gamma") -> np.ndarray:
    """gamma (H,) float32. Raises DataError when it is no number > 0, or not one for each hinge point."""
    try:
        widths = np.broadcast_to(np.asarray(gamma, np.float32), count).copy()
    except (TypeError, ValueError) as error:
        raise DataError(f"{name} must be one number, or one for each of {count} hinge points") from error
    if not (np.isfinite(widths).all() and (widths > 0).all()):
        raise DataError(f"{name} must be finite and > 0")
    return widths


def check_resolution(X: np.ndarray, gamma: np.ndarray) -> None:
    """Raise DataError where points (N, d) float32 lie too far from the origin for kernels of width gamma."""
    far = float(np.abs(X).max(initial=0))
    step, width = float(np.spacing(np.float32(far))), float(1 / np.sqrt(gamma.max(initial=1e-30)))
    if step > COARSEST * width:
        raise DataError(
            f"points lie up to {far:.4g} from the origin, where float32 moves in steps of {step:.2g}: too "
            f"coarse for kernels {width:.2g} wide (gamma {gamma.max():.4g}); subtract a point near the data "
            "from X and the hinge points, and from what is asked later"
        )


def check_grid(X: np.ndarray, spacing: float) -> None:
    """Raise DataError when a grid of hinge points around X (N, d) would not fit into memory."""
    count = float(np.prod(np.ptp(X, axis=0).astype(float) / spacing + 2))
    if count > LARGEST_GRID:
        raise DataError(
            f"a grid of hinge points {spacing:g} apart over points that span {np.ptp(X, axis=0).max():.4g} "
            f"would have {count:.2g} of them; are points in metres? Scale them, set hinge_spacing and gamma, "
            "or give hinge points"
        )


def check_reached(reached: np.ndarray) -> None:
    """Raise DataError when next to none of the samples (N,) bool is in reach of a hinge point."""
    if reached.mean() < LEAST_REACHED:
        raise DataError(
            f"{np.count_nonzero(reached)} of {len(reached)} points lie in reach of a hinge point; are "
            "points, hinge points and gamma (1/m^2 for points in metres) in the same unit and frame?"
        )
