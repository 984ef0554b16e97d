"""Solids of neighbours made exclusive: a place that two objects claim goes to the one that claims it more.

Each object's solid comes from a lattice of its own, and fusion may raise two of them at one node: both have
seen points there, or hidden sides that follow from what was seen. The border between two is where their
claims are equal. Knows lattices of one spacing and origin; knows nothing of objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from mapping.compiled import compiled

ALIKE = np.float32(0.01)
"""Log odds of a node that two objects claim alike: it is the first one's."""


def exclusive(
    lattices: Sequence[np.ndarray], firsts: Sequence[np.ndarray], ranks: Sequence[int]
) -> list[np.ndarray]:
    """Log odds of K objects, (nx, ny, nz) float32 each, lowered so that no two add up to more than 0.

    Then surfaces where they cross 0 do not go through each other. firsts: the lattices' first nodes (3,) in
    one lattice that holds them all. ranks: an object yields to those of a higher rank, and of two of one rank
    both are lowered alike. What need not be lowered is the same array.
    """
    found = list(lattices)
    ends = [first + lattice.shape for first, lattice in zip(firsts, lattices)]
    for one, other in combinations(range(len(found)), 2):
        low, high = np.maximum(firsts[one], firsts[other]), np.minimum(ends[one], ends[other])
        if (low >= high).any():
            continue
        a, b = (_part(found[k], low - firsts[k], high - firsts[k]) for k in (one, other))
        if not _contested(a, b):
            continue
        for k in (one, other):
            if found[k] is lattices[k]:
                found[k] = lattices[k].copy()
        a, b = (_part(found[k], low - firsts[k], high - firsts[k]) for k in (one, other))
        _settle(a, b, np.float32(0.5 + np.sign(ranks[other] - ranks[one]) / 2))
    return found


def _part(lattice: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """A view of the nodes low..high (3,) of a lattice."""
    x, y, z = (slice(a, b) for a, b in zip(low, high))
    return lattice[x, y, z]


@compiled
def _contested(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether two objects claim a node of the same place, or so nearly that their surfaces may cross."""
    nx, ny, nz = a.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if a[i, j, k] + b[i, j, k] > 0:
                    return True
    return False


@compiled
def _settle(a: np.ndarray, b: np.ndarray, share: float) -> None:
    """Lower the claims of two objects (nx, ny, nz) on the same nodes until they add up to nothing, the
    first one's by a share of the difference."""
    nx, ny, nz = a.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                both = a[i, j, k] + b[i, j, k]
                if both > 0:
                    left = a[i, j, k] - share * both
                    if abs(left) < ALIKE:
                        left = ALIKE if left >= 0 else -ALIKE
                    a[i, j, k], b[i, j, k] = left, -left
