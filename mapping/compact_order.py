"""An order of points in which any few that follow each other lie in a small box.

Knows points; must not know what they are for.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


def compact_order(X: np.ndarray, together: int) -> np.ndarray:
    """Indices (N,) int64 of points (N, d), halved again and again along their longest side, down to groups of
    `together` that begin at multiples of it. The same points in the same order give the same."""
    return _halved(np.array(X, np.float32, order="C"), together)


@compiled
def _halved(X: np.ndarray, together: int) -> np.ndarray:
    """The same; X is put in order as well."""
    order = np.arange(len(X))
    waiting = [(0, len(X))]
    while waiting:
        first, last = waiting.pop()
        count = last - first
        if count <= together:
            continue
        axis, longest = 0, np.float32(-1)
        for a in range(X.shape[1]):
            low = high = X[first, a]
            for i in range(first + 1, last):
                low, high = min(low, X[i, a]), max(high, X[i, a])
            if high - low > longest:
                axis, longest = a, high - low
        half = first + (count // 2 + together - 1) // together * together
        _select(X, order, axis, first, last - 1, half)
        waiting.append((first, half))
        waiting.append((half, last))
    return order


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
