"""Quantiles of plain arrays; NumPy's own, made for every case, take milliseconds a call."""

from __future__ import annotations

import numpy as np


def quantiles(values: np.ndarray, *shares: float) -> np.ndarray:
    """Quantiles (len(shares),) float64 of values (N,), linear between neighbours, as numpy.quantile's."""
    ordered = np.sort(values)
    place = np.asarray(shares, np.float64) * (len(ordered) - 1)
    first = np.floor(place).astype(np.int64)
    last = np.minimum(first + 1, len(ordered) - 1)
    low, high = ordered[first].astype(np.float64), ordered[last].astype(np.float64)
    return low + (place - first) * (high - low)
