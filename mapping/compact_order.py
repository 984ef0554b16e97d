"""An order of points in which any few that follow each other lie in a small box.

Knows points; must not know what they are for.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from mapping.threads import map_in_threads

SHARED_FROM = 10_000
"""Points from which on two threads share them."""


def compact_order(X: np.ndarray, together: int) -> np.ndarray:
    """Indices (N,) int64 of points (N, d), halved again and again along their longest side, down to groups of
    `together` that begin at multiples of it. The same points in the same order give the same."""
    X, order = np.array(X, np.float32, order="C"), np.arange(len(X))
    parts = [(0, len(X))]
    if len(X) >= SHARED_FROM:
        half = _halve(X, order, 0, len(X), together)
        parts = [(0, half), (half, len(X))]
    map_in_threads(lambda part: _order(X, order, *part, together), parts)
    return order


@compiled
def _order(X: np.ndarray, order: np.ndarray, first: int, last: int, together: int) -> None:
    """Put a part of order (N,), and of the points X with it, in such an order."""
    waiting = [(first, last)]
    while waiting:
        first, last = waiting.pop()
        if last - first > together:
            half = _halve(X, order, first, last, together)
            waiting.append((first, half))
            waiting.append((half, last))


@compiled
def _halve(X: np.ndarray, order: np.ndarray, first: int, last: int, together: int) -> int:
    """Put two halves of a part apart along its longest side; where the second one begins."""
    axis, longest = 0, np.float32(-1)
    for a in range(X.shape[1]):
        low = high = X[first, a]
        for i in range(first + 1, last):
            low, high = min(low, X[i, a]), max(high, X[i, a])
        if high - low > longest:
            axis, longest = a, high - low
    half = first + ((last - first) // 2 + together - 1) // together * together
    _select(X, order, axis, first, last - 1, half)
    return half


@compiled
def _select(X: np.ndarray, order: np.ndarray, axis: int, first: int, last: int, place: int) -> None:
    """Put points first..last in such an order that none before `place` is beyond it along an axis (Hoare)."""
    while first < last:
        # The median of three keeps the halves even for points that are in order already.
        a, b, c = X[first, axis], X[(first + last) // 2, axis], X[last, axis]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = first, last
        while i <= j:
            while X[i, axis] < pivot:
                i += 1
            while X[j, axis] > pivot:
                j -= 1
            if i <= j:
                for k in range(X.shape[1]):
                    X[i, k], X[j, k] = X[j, k], X[i, k]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if place <= j:
            last = j
        elif place >= i:
            first = i
        else:
            return
